"""One job: live, through losses of the service, and after its end."""

import json
import re
from datetime import timedelta
from typing import Any

import pytest
from fastapi import FastAPI, Request
from playwright.sync_api import expect

from api.app import create_app
from core.jobs.job import Progress, utc_now
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.api.conftest import NOON, NOWHERE, Attempt, Stack, job, serving
from tests.api.pages.conftest import MakeTab, Tab, flaws
from tests.in_memory import MemoryJobQueue


@pytest.fixture
def attempt(stack: Stack) -> Attempt:
    return Attempt(stack, job(name="first steps", algorithm={"kind": "ppo", "num_timesteps": 1000}))


def measure(stack: Stack, attempt: Attempt, step: int, **values: float) -> None:
    named = {name.replace("__", "/"): value for name, value in values.items()}
    attempt.say("metrics", step=step, values=named)
    progress = Progress(step=step, total=1000, steps_per_second=10.0, metrics=named)
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id=f"progress {step}")


def test_a_new_metric_is_on_the_page_within_half_a_second(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    measure(stack, attempt, 100, eval__episode_reward=1.0)
    page = tab.open(f"#/jobs/{attempt.id}")
    curve = page.get_by_role("img", name="Return. eval: last 1 at 100")
    expect(curve).to_be_visible()
    measure(stack, attempt, 200, eval__episode_reward=2.5)
    # The feed is looked at each 100 ms; the bench `page` measures it, this waits for it.
    expect(page.get_by_role("img", name="Return. eval: last 2.5 at 200")).to_be_visible()
    levels = {"training__terrain_level_2": 0.25, "training__terrain_level_10": 0.75}
    measure(stack, attempt, 300, eval__episode_reward=7.0, training__terrain_level=8.0, **levels)
    expect(page.get_by_role("img", name="last 7 at 300, least 1, greatest 7")).to_be_visible()
    page.reload()
    card = page.locator("section").filter(has=page.get_by_role("heading", name="Levels of the terrain"))
    expect(card.get_by_role("listitem")).to_have_text(["level 225 %", "level 1075 %"])
    expect(card.get_by_text("at level 8 in the mean")).to_be_visible()
    tab.picture("job-levels")


def test_a_job_is_renamed_labelled_and_noted_while_it_runs(stack: Stack, tab: Tab) -> None:
    attempt = Attempt(stack, job(name="first steps", labels={"team": "legs", "draft": "1"}))
    page = tab.open(f"#/jobs/{attempt.id}")
    page.get_by_role("button", name="Edit").click()
    form = page.get_by_role("form", name="Edit the job")
    expect(form.get_by_label("Name")).to_be_focused()
    form.get_by_label("Name").fill("soft knees")
    form.get_by_role("button", name="Remove the label draft").click()
    form.get_by_label("One more").fill("knee soft")
    expect(form.get_by_text("A label is a key and a value")).to_be_visible()
    form.get_by_label("One more").fill("knee: soft")
    form.get_by_role("button", name="Add it").click()
    form.get_by_label("One more").fill("x=y: z")  # The form takes what was only typed, too.
    form.get_by_label("Note").fill("Too stiff.\nCompare with the next one.")
    assert flaws(page) == []
    tab.picture("job-edit")
    # What somebody else changes meanwhile stays.
    stack.http.patch(f"/jobs/{attempt.id}", json={"labels": {"seen": "bob"}})
    form.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="soft knees")).to_be_visible()
    expect(page.get_by_role("note")).to_have_text("Too stiff.\nCompare with the next one.")
    stored = stack.store.get(attempt.id)
    assert stored.spec.labels == {"team": "legs", "seen": "bob", "knee": "soft", "x": "y: z"}
    assert flaws(page) == []
    tab.picture("job-noted")
    page.get_by_role("button", name="Edit").click()
    form.get_by_label("Note").fill("")
    form.get_by_role("button", name="Leave it as it was").click()
    expect(page.get_by_role("note")).to_be_visible()


def test_a_start_that_takes_long_says_why_and_a_battery_says_what_it_is(
    stack: Stack, tab: Tab, attempt: Attempt
) -> None:
    compiling = Progress(step=0, total=1000, phase="compiling")
    stack.store.record(attempt.id, attempt.claim.token, "events", [], compiling, write_id="a")
    head = tab.open(f"#/jobs/{attempt.id}").locator(".about-job")
    expect(head).to_contain_text("0 of 1K steps · compiles…")
    expect(head).not_to_contain_text("minutes")
    tab.page.clock.set_fixed_time(utc_now() + timedelta(seconds=100))
    tab.page.reload()
    expect(head).to_contain_text(
        "compiles (started 2 min ago); the first time may take minutes, "
        "a later start of the same job is shorter…"
    )
    tab.picture("job-compiles")
    testing = Progress(step=1000, total=1000, steps_per_second=10.0, phase="testing")
    stack.store.record(attempt.id, attempt.claim.token, "events", [], testing, write_id="b")
    expect(head).to_contain_text("1K of 1K steps · tests the policy in C MuJoCo: the battery…")


@pytest.mark.extra
def test_every_metric_has_a_curve_over_steps_or_time_smoothed_and_on_a_log_axis(
    stack: Stack, tab: Tab, attempt: Attempt
) -> None:
    for step in (100, 200, 300):
        measure(stack, attempt, step, eval__episode_reward=float(step), training__loss=-1.0)
    page = tab.open(f"#/jobs/{attempt.id}/curves")
    expect(page.get_by_role("group", name="training/loss")).to_be_visible()
    page.get_by_label("Smoothing").fill("0.5")
    # 100, 200, 300 by weight 0.5: (25 + 100 + 75 · …)/… = (0.25·100/2 + 0.5·200/2 + 300/2) / 0.875 = 242.86
    expect(page.get_by_role("img", name="smoothed: last 242.9 at 300")).to_be_visible()
    page.get_by_label("Log axis").check()
    expect(page.get_by_text("No values above zero to show on a log axis.")).to_be_visible()
    page.get_by_label("Metrics").fill("reward")
    expect(page.get_by_role("group", name="training/loss")).to_have_count(0)
    page.get_by_label("Over").select_option("time")
    assert all(part in page.url for part in ("x=time", "smooth=0.5", "log=1", "metric=reward"))
    page.reload()
    expect(page.get_by_label("Log axis")).to_be_checked()


@pytest.mark.extra
def test_curves_come_in_sections_and_what_is_pinned_comes_first(
    stack: Stack, make_tab: MakeTab, attempt: Attempt
) -> None:
    """9.7: the important ones first, sums of positions closed and explained, pins kept by the browser."""
    names = ["eval/episode_reward", "training/sps", "training/v_loss", "training/height"]
    names += ["eval/episode_reward_survive", "eval/walltime", "eval/episode_distance_from_origin"]
    for step in (100, 200):
        measure(stack, attempt, step, **{name.replace("/", "__"): 1.0 for name in names})
    tab = make_tab()
    page = tab.open(f"#/jobs/{attempt.id}/curves")
    shown = page.locator("figure.chart h2")
    expect(shown).to_have_text(["eval/episode_reward", "training/sps", "training/v_loss"])
    headings = page.locator("details.curves > summary")
    sums = "Sums over an episode's steps 1"
    expect(headings).to_have_text(["Important 3", "Reward by term 1", "Evaluation 1", "Training 1", sums])
    headings.filter(has_text="Sums").click()
    expect(page.get_by_text("Divided by the episode's length they are means.")).to_be_visible()
    headings.filter(has_text="Training").click()
    page.get_by_role("button", name="Pin training/height").click()
    expect(shown.first).to_have_text("training/height")
    assert tab.violations() == []
    tab.picture("curves-pinned")
    page.reload()
    expect(headings.first).to_have_text("Pinned 1")
    expect(shown.last).to_have_text("eval/episode_distance_from_origin")
    page.get_by_role("button", name="Pin training/height").click()
    expect(headings.first).to_have_text("Important 3")
    # What is looked for is shown wherever it stands.
    page.get_by_label("Metrics").fill("walltime")
    expect(shown).to_have_text(["eval/walltime"])


@pytest.mark.extra
def test_ticks_have_the_digits_that_they_need(tab: Tab) -> None:
    """9.3: "1.5M 1.8M 2M 2.3M" stood at equal distances."""
    page = tab.open()
    told = page.evaluate(
        """async () => {
          const pages = document.querySelector("script[src]").src.replace("app.js", "");
          const { stepTicks, ticks, timeTicks } = await import(pages + "lib/format.js");
          return [
            stepTicks([1.5e6, 1.75e6, 2e6, 2.25e6]), stepTicks([999990, 999995, 1e6, 1000005]),
            ticks([0, 0.1, 0.2, 0.1 + 0.2], 0.1), ticks([12345, 12345.5], 0.5),
            ticks([-2.5e-5, 0, null], 2.5e-5),
            ticks([1000000, 1000250], 250), timeTicks([0, 30, 60, 90], 30), timeTicks([120, 150, 180], 30),
            timeTicks([3600, 4500, 7200, 9000], 900), timeTicks([3590, 3605], 15),
            timeTicks([0, 3600, 86400], 3600),
            timeTicks([600, 1200], 600),
          ];
        }"""
    )
    assert told == [
        ["1.5M", "1.75M", "2M", "2.25M"],
        ["999.99K", "999.995K", "1M", "1.000005M"],
        ["0", "0.1", "0.2", "0.3"],
        ["12345", "12345.5"],
        ["-2.5e-5", "0", ""],
        ["1e6", "1.00025e6"],
        ["0 s", "30 s", "60 s", "90 s"],
        ["2:00 min", "2:30 min", "3:00 min"],
        ["1:00 h", "1:15 h", "2:00 h", "2:30 h"],
        ["59:50 min", "1:00:05 h"],
        ["0 h", "1 h", "24 h"],
        ["10 min", "20 min"],
    ]


@pytest.mark.extra
def test_the_tabs_title_says_how_the_job_goes(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    """9.7: it never changed."""
    page = tab.open(f"#/jobs/{attempt.id}/log")
    expect(page).to_have_title("running first steps · Log · Gaitway")
    measure(stack, attempt, 620, eval__episode_reward=1.0)
    attempt.say("progress", step=620, total=1000, metrics={})
    expect(page).to_have_title("62 % first steps · Log · Gaitway")
    attempt.end()
    expect(page).to_have_title("succeeded first steps · Log · Gaitway")
    page.get_by_role("link", name="Models").click()
    expect(page).to_have_title("Models · Gaitway")


@pytest.mark.extra
def test_a_queued_job_says_why_it_waits(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    busy = WorkerInfo(
        name="worker-1",
        host="h",
        pid=1,
        device="cpu",
        queues=queue_names("cpu"),
        job=attempt.id,
        started_at=NOON,
        seen_at=NOON,
    )
    stack.store.announce(busy, timedelta(minutes=1))
    stack.store.add(job("0" * 12 + "-0000000001", name="first"))
    later = job("0" * 12 + "-0000000002", name="second").model_copy(
        update={"created_at": NOON + timedelta(seconds=1)}
    )
    stack.store.add(later)
    page = tab.open(f"#/jobs/{later.id}")
    said = page.get_by_text(
        "It waits. It is for the one worker that takes jobs like it; 1 job has its turn before it"
    )
    expect(said).to_be_visible()
    said.get_by_role("link", name="The queue").click()
    expect(page.get_by_role("heading", name="Queue")).to_be_visible()
    # The form's stills wait for the same worker.
    tab.open("#/submit?environment=ant")
    stills = page.get_by_role("region", name="The body")
    expect(stills).to_contain_text(f"It waits for the worker, which is busy with job {attempt.id}.")
    tab.picture("submit-waits")


@pytest.mark.extra
def test_on_a_phone_the_replay_begins_in_the_upper_third(
    stack: Stack, make_tab: MakeTab, attempt: Attempt
) -> None:
    """9.7: 530 of 800 pixels were header."""
    measure(stack, attempt, 300, eval__episode_reward=1.0)
    page = make_tab(380).open(f"#/jobs/{attempt.id}/specification")
    expect(page.get_by_role("region", name="All settings")).to_be_visible()
    tabs = page.get_by_role("navigation", name="Parts of the job").bounding_box()
    assert tabs is not None
    assert tabs["y"] + tabs["height"] < 265
    # The tab that is shown is in sight though it is the last of a row that is wider than the window.
    expect(page.get_by_role("link", name="Specification")).to_be_in_viewport(ratio=0.9)


@pytest.mark.extra
def test_a_part_of_the_curve_is_drawn_by_dragging(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    for step in range(0, 1000, 100):
        measure(stack, attempt, step, eval__episode_reward=float(step))
    page = tab.open(f"#/jobs/{attempt.id}/curves")
    over = page.get_by_role("group", name="eval/episode_reward").locator(".u-over")
    box = over.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.9, box["y"] + 60, steps=5)
    page.mouse.up()
    expect(page.get_by_label("From (step)")).not_to_have_value("")
    # The service sends the part's rows alone: from about the middle of 0 to 900 up to about 810.
    expect(page.get_by_role("img", name="last 800 at 800, least 500")).to_be_visible()
    page.get_by_role("button", name="Show all").click()
    expect(page.get_by_role("img", name="last 900 at 900, least 0")).to_be_visible()


def test_the_log_follows_and_markup_in_it_is_text(tab: Tab, attempt: Attempt) -> None:
    attempt.print("compiled in <b>12 s</b>")
    page = tab.open(f"#/jobs/{attempt.id}/log")
    expect(page.get_by_role("log")).to_have_text("compiled in <b>12 s</b>\n")
    attempt.print("a second line")
    expect(page.get_by_role("log")).to_contain_text("a second line")


@pytest.mark.extra
def test_videos_have_a_slider_through_training_and_a_fork_at_each_checkpoint(
    tab: Tab, attempt: Attempt
) -> None:
    for step in (100, 200):
        attempt.keep(
            f"checkpoint-{step}.msgpack", role="checkpoint", media_type="application/octet-stream", step=step
        )
        attempt.keep(f"video-{step}.mp4", step=step)
    page = tab.open(f"#/jobs/{attempt.id}")
    slider = page.get_by_role("slider", name="Video")
    expect(slider).to_have_attribute("aria-valuetext", "at step 200")
    slider.fill("0")
    expect(page.get_by_text("Video at step 100 (1 of 2)")).to_be_visible()
    page.get_by_role("link", name="Fork from this checkpoint").click()
    said = page.get_by_role("region", name="The submission as JSON")
    expect(said).to_contain_text('"resume_from": {')
    expect(said).to_contain_text('"step": 100')


@pytest.mark.extra
def test_a_fork_of_the_last_checkpoint_has_steps_left_to_train(tab: Tab, attempt: Attempt) -> None:
    attempt.keep("checkpoint.msgpack", role="checkpoint", media_type="application/octet-stream", step=1000)
    page = tab.open(f"#/jobs/{attempt.id}")
    page.get_by_role("link", name="Fork from this checkpoint").click()
    # The job's own budget of 1,000 is used; the fork has as many again.
    expect(page.get_by_label("num timesteps", exact=True)).to_have_value("2000")


@pytest.mark.extra
def test_the_best_evaluation_and_its_policy_are_named(tab: Tab, attempt: Attempt) -> None:
    attempt.keep(
        "policy-best",
        b"weights",
        role="best_policy",
        media_type="application/octet-stream",
        step=1200,
        metadata={"return": 81.25},
    )
    page = tab.open(f"#/jobs/{attempt.id}")
    expect(page.get_by_text("Best: return 81.25 at step 1,200.")).to_be_visible()
    link = page.get_by_role("link", name="Download its policy")
    expect(link).to_have_attribute("href", f"/jobs/{attempt.id}/artifacts/policy-best")
    page.get_by_role("link", name="roll it out").click()
    said = page.get_by_role("region", name="The submission as JSON")
    expect(said).to_contain_text('"which": "best"')
    expect(said).not_to_contain_text('"step"')


@pytest.mark.extra
def test_a_battery_is_shown_with_its_verdict(tab: Tab, attempt: Attempt) -> None:
    row = {"command": [0.5, 0, 0], "episodes": 32, "falls": 1, "linear_tracking": 0.91, "yaw_rate": None}
    falls = {"quantity": "falls", "value": 0.03125, "bound": 0.01, "met": False}
    facts = {"passed": False, "criteria": [falls], "commands": [row], "spec": {"seconds": 8, "push": None}}
    attempt.keep("battery.json", b"{}", role="battery", media_type="application/json", metadata=facts)
    page = tab.open(f"#/jobs/{attempt.id}")
    section = page.get_by_role("region", name="Battery", exact=True)
    expect(section).to_contain_text("Battery: not passed")
    expect(section.get_by_role("listitem")).to_have_text(re.compile(r"✗ Falls: 3.1\d* %\s+at most 1 %"))
    expect(section.get_by_role("row").nth(1)).to_have_text(re.compile(r"0.5, 0, 0\s*1 of 32\s*0.91"))
    assert tab.violations() == []


def over_time(*clips: str) -> dict[str, Any]:
    """Errors that rise over 4 s; no episode was in the first part of the second clip."""
    names = {"joints": ["left_knee", "right_knee_with_a_long_name"], "bodies": ["torso"]}
    rising = [[number / 100, number / 200] for number in range(50)]
    lacking = [[None, None], *rising[1:]]
    found = [
        {"clip": name, "seconds": 4.0, "joints": rows, "bodies": [row[:1] for row in rows]}
        for name, rows in zip(clips, (rising, lacking), strict=True)
    ]
    return {**names, "clips": found}


@pytest.mark.extra
def test_a_battery_of_clips_is_shown_clip_by_clip(tab: Tab, attempt: Attempt) -> None:
    row = {"clip": "carries a box", "episodes": 32, "reached": 0.75, "root_error": 0.081, "joint_error": 0.12}
    reached = {"quantity": "reached", "value": 0.75, "bound": 0.95, "met": False}
    root = {"quantity": "root_error", "value": 0.0127, "bound": 0.01, "met": False}
    of_clips = {"commands": [], "clips": [row], "spec": {"seconds": 8, "push": None}}
    facts = {"passed": False, "criteria": [reached, root], **of_clips}
    whole = {**facts, "over_time": over_time("carries a box", "turns")}
    attempt.keep(
        "battery.json",
        json.dumps(whole).encode(),
        role="battery",
        media_type="application/json",
        metadata=facts,
    )
    page = tab.open(f"#/jobs/{attempt.id}")
    section = page.get_by_role("region", name="Battery", exact=True)
    expect(section.get_by_role("listitem").first).to_have_text(
        re.compile(r"✗ To the end: 75 %\s+at least 95 %")
    )
    root_line = re.compile(r"✗ Root, m: 0.013\s+at most 0.01")
    expect(section.get_by_role("listitem").nth(1)).to_have_text(root_line)
    expect(section.get_by_role("row").nth(1)).to_have_text(
        re.compile(r"carries a box\s*75 % of 32\s*0.081\s*0.120")
    )
    expect(section).to_contain_text("each clip to its end")
    joints = section.get_by_role("group", name="Joints, rad")
    # The mean of 0, 0.01, …, 0.49 is 0.245; of the second joint half of that.
    expect(joints.get_by_role("listitem")).to_have_text(
        ["left_knee0.245", "right_knee_with_a_long_name0.122"]
    )
    joints.locator("rect[data-bin='10'][data-column='1']").hover()
    expect(joints.get_by_role("status")).to_have_text("right_knee_with_a_long_name, 0.80 to 0.88 s: 0.05 rad")
    section.get_by_label("Clip", exact=True).select_option("turns")
    section.locator("rect[data-bin='0'][data-column='0']").first.hover()
    expect(joints.get_by_role("status")).to_contain_text("no episode was there")
    assert flaws(page) == []
    tab.picture("battery-clips")


@pytest.mark.extra
def test_the_latent_space_is_drawn_by_share_and_by_clip(tab: Tab, attempt: Attempt) -> None:
    where = {"episode": [0, 0, 1], "time_s": [0.0, 0.5, 0.0], "clip": [0, 0, 1], "share": [0.0, 0.5, 0.0]}
    plane = {"layer": "latent/mean", "size": 60, "variance": [0.6, 0.25], "clips": ["walk", "turn"]}
    found = {**plane, "x": [-1.0, 0.0, 1.0], "y": [0.5, -1.0, 0.5], **where}
    content = json.dumps(found).encode()
    attempt.keep("latent.json", content, role="recording", media_type="application/json")
    page = tab.open(f"#/jobs/{attempt.id}")
    section = page.get_by_role("region", name="Latent space")
    said = "3 steps of latent/mean; across component 1, 60 % of the variance, up component 2, 25 % of the"
    expect(section.get_by_role("img", name=said)).to_be_visible()
    section.get_by_label("Colour", exact=True).select_option("Clip")
    expect(section.get_by_role("listitem")).to_have_text(["walk", "turn"])
    assert flaws(page) == []
    tab.picture("job-latent")


@pytest.mark.extra
def test_phases_costs_and_terms_are_there(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    attempt.say("phase", name="compile", seconds=12.5)
    measure(
        stack,
        attempt,
        100,
        eval__episode_reward_forward=3.0,
        eval__episode_cost_control=-1.0,
        eval__walltime=2.0,
    )
    page = tab.open(f"#/jobs/{attempt.id}")
    expect(page.locator(".bars li").filter(has_text="compile")).to_contain_text("13 s")
    expect(page.locator(".bars li").filter(has_text="evaluate")).to_contain_text("2 s")
    expect(page.locator(".bars li").filter(has_text="reward_forward")).to_contain_text("3")
    for name, seconds in (("policy", 1.5), ("video.mp4", 0.5)):
        attempt.say("artifact", name=name, role="policy", step=100, upload_s=seconds)
    expect(page.locator(".bars li").filter(has_text="upload")).to_contain_text("2 s")
    attempt.say("phase", name="first_update", seconds=3.0)
    expect(page.locator(".bars li").filter(has_text="first update")).to_contain_text("3 s")


@pytest.mark.extra
def test_the_specification_stands_beside_what_defaults_filled_in(tab: Tab, attempt: Attempt) -> None:
    page = tab.open(f"#/jobs/{attempt.id}/specification")
    table = page.get_by_role("region", name="All settings")
    sent = table.get_by_role("row").filter(has_text="algorithm.num_timesteps")
    expect(sent).to_contain_text("1000")
    expect(sent).to_contain_text("sent")
    # Tuned for the ant on a CPU, and nowhere in what was sent.
    expect(table.get_by_role("row").filter(has_text="algorithm.clipping_epsilon").first).to_contain_text(
        "filled in"
    )
    expect(table.get_by_role("row").filter(has_text="environment.options.ctrl_cost_weight")).to_contain_text(
        "0.5"
    )


def test_a_job_is_cancelled_after_one_more_question(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    page = tab.open(f"#/jobs/{attempt.id}")
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="No").click()
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Yes, cancel").click()
    expect(page.locator(".status")).to_have_text("cancelling")
    assert stack.store.get(attempt.id).status == JobStatus.CANCELLING
    attempt.end(JobStatus.CANCELLED, Reason.USER_CANCELLED)
    expect(page.locator(".status")).to_have_text("cancelled")
    expect(page.locator(".message")).to_have_text("user_cancelled: It came to its end.")


@pytest.mark.extra
@pytest.mark.parametrize("tab_name", ["overview", "curves", "log", "files"])
def test_a_job_that_left_nothing_says_so(stack: Stack, tab: Tab, tab_name: str) -> None:
    attempt = Attempt(stack, job(video=None))
    attempt.end(JobStatus.FAILED, Reason.TRAINING_CRASHED)
    page = tab.open(f"#/jobs/{attempt.id}/{tab_name}")
    said = {
        "overview": "This job asks for no video.",
        "curves": "The job ended before it measured anything.",
        "log": "The job printed nothing.",
        "files": "The job left no files.",
    }
    expect(page.get_by_text(said[tab_name])).to_be_visible()


@pytest.mark.extra
def test_a_job_that_is_deleted_while_somebody_looks(stack: Stack, tab: Tab, attempt: Attempt) -> None:
    attempt.end()
    page = tab.open(f"#/jobs/{attempt.id}")
    page.get_by_role("button", name="Delete").click()
    # Another reader was faster.
    assert stack.http.delete(f"/jobs/{attempt.id}").status_code == 204
    page.get_by_role("button", name="Yes, delete").click()
    expect(page.get_by_role("alert")).to_contain_text(attempt.id)
    page.reload()
    expect(page.get_by_role("alert")).to_contain_text("There is no job")


@pytest.mark.extra
def test_a_job_that_another_reader_deletes_is_said_to_be_gone(
    stack: Stack, tab: Tab, attempt: Attempt
) -> None:
    page = tab.open(f"#/jobs/{attempt.id}")
    expect(page.locator(".status")).to_have_text("running")
    attempt.end()
    expect(page.locator(".status")).to_have_text("succeeded")
    assert stack.http.delete(f"/jobs/{attempt.id}").status_code == 204
    # An ended job is asked for every 5 s.
    expect(page.get_by_text("Somebody deleted this job.")).to_be_visible(timeout=10_000)
    page.get_by_role("link", name="To the jobs").click()
    expect(page.get_by_text("No jobs yet.")).to_be_visible()


def test_a_service_that_goes_away_and_comes_back(stack: Stack, make_tab: MakeTab, attempt: Attempt) -> None:
    app: FastAPI = create_app(NOWHERE, store=stack.store, queue=MemoryJobQueue(), objects=stack.objects)
    measure(stack, attempt, 100, eval__episode_reward=1.0)
    with serving(app) as port:
        tab = make_tab(port=port)
        page = tab.open(f"#/jobs/{attempt.id}")
        expect(page.get_by_role("img", name="last 1 at 100")).to_be_visible()
    expect(page.get_by_text("The service does not answer.")).to_be_visible()
    measure(stack, attempt, 200, eval__episode_reward=2.0)
    again: FastAPI = create_app(NOWHERE, store=stack.store, queue=MemoryJobQueue(), objects=stack.objects)
    seen: list[str | None] = []

    @again.middleware("http")
    async def note(request: Request, answer: Any) -> Any:
        if request.url.path.endswith("/events"):
            # The page's own new stream says it in the address.
            seen.append(request.headers.get("last-event-id") or request.query_params.get("after"))
        return await answer(request)

    with serving(again, port):
        expect(page.get_by_role("img", name="last 2 at 200")).to_be_visible()
        assert int(seen[0] or 0) > 0
        expect(page.get_by_text("The service does not answer.")).to_have_count(0)
        page.close()


@pytest.mark.extra
def test_a_job_of_several_seeds_shows_one_ones_files_and_all_their_curves(stack: Stack, tab: Tab) -> None:
    attempt = Attempt(stack, job(name="three", seeds=[4, 0]))
    for step in (100, 200):
        measure(
            stack,
            attempt,
            step,
            eval__episode_reward=2.0,
            **{"seed_4__eval__episode_reward": 1.0, "seed_0__eval__episode_reward": 3.0},
        )
    for seed in (4, 0):
        facts = {"seed": seed, "return": 10.0 + seed}
        attempt.keep(f"video-seed-{seed}.mp4", b"film", metadata=facts)
        attempt.keep(f"policy-best-seed-{seed}", b"best", role="best_policy", step=200, metadata=facts)
    page = tab.open(f"#/jobs/{attempt.id}")
    video = page.locator("video")
    expect(video).to_have_attribute("src", re.compile("video-seed-4.mp4$"))
    expect(page.get_by_text("Best: return 14")).to_be_visible()
    page.get_by_label("Seed").select_option("0")
    expect(video).to_have_attribute("src", re.compile("video-seed-0.mp4$"))
    expect(page.get_by_text("Best: return 10")).to_be_visible()
    assert "seed=0" in page.url
    expect(page.get_by_role("link", name="roll it out")).to_have_attribute("href", re.compile("seed=0$"))
    expect(page.get_by_role("img", name="Return. eval: last 2 at 200")).to_be_visible()
    expect(page.locator(".u-legend").get_by_text("eval, seed 4")).to_be_visible()
    page.get_by_role("link", name="Curves").click()
    expect(page.locator("figure.chart h2")).to_have_text(["eval/episode_reward"])
    expect(page.locator(".u-legend").get_by_text("seed 0")).to_be_visible()
    page.get_by_role("link", name="Files").click()
    for seed in (4, 0):
        expect(page.get_by_role("link", name=f"video-seed-{seed}.mp4")).to_be_visible()
    page = tab.open("#/jobs")
    expect(page.get_by_text("seeds 4, 0")).to_be_visible()
