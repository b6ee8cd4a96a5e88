"""Comparing, submitting, models, the HTTP interface; and what all views must be."""

import ast
import csv
import io
import json
import re
import shlex
from datetime import timedelta
from pathlib import Path

import av
import numpy as np
import pytest
from playwright.sync_api import expect

from core.jobs.job import utc_now
from core.jobs.queue import queue_names
from core.jobs.workers import WorkerInfo
from core.news.webhook import Outcome, new_message
from core.rendering.mp4 import Mp4Writer
from core.user_models.record import ModelRecord
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.pages.conftest import MakeTab, Tab, flaws


@pytest.fixture
def pair(stack: Stack) -> list[Attempt]:
    """Two jobs that differ in their seeds and learning rates."""
    attempts = [
        Attempt(
            stack,
            job(
                f"{number:012x}-0000000000",
                name=f"seed {number}",
                seed=number,
                algorithm={"kind": "ppo", "learning_rate": number / 1000},
            ),
        )
        for number in (1, 2)
    ]
    for number, attempt in enumerate(attempts, 1):
        for step in (100, 200):
            attempt.say("metrics", step=step, values={"eval/episode_reward": float(step * number)})
    return attempts


def test_jobs_are_picked_and_compared(stack: Stack, tab: Tab, pair: list[Attempt]) -> None:
    page = tab.open()
    for name in ("seed 1", "seed 2"):
        page.get_by_label(f"Choose {name}").check()
    page.get_by_role("link", name="Compare", exact=True).click()
    expect(page.get_by_role("heading", name="Compare 2 jobs")).to_be_visible()
    expect(page.get_by_role("img", name="seed 1: last 200 at 200")).to_be_visible()
    table = page.get_by_role("region", name="Settings that differ")
    expect(table.get_by_role("row").filter(has_text="algorithm.learning_rate")).to_contain_text("0.001")
    settings = [row.split("\t")[0] for row in table.inner_text().splitlines()]
    assert [name for name in settings if "." in name or name == "seed"] == ["seed", "algorithm.learning_rate"]


@pytest.mark.extra
def test_seeds_of_one_setting_are_shown_as_a_band(stack: Stack, tab: Tab) -> None:
    """Where only one seed has a value, another counts as straight between its own, and not beyond them."""
    returns = {1: {100: 10.0, 300: 30.0}, 2: {100: 30.0, 200: 60.0, 300: 50.0}, 3: {100: 20.0}}
    ids = list[str]()
    for seed, values in returns.items():
        attempt = Attempt(stack, job(f"{seed:012x}-0000000000", name=f"try {seed}", seed=seed))
        for step, value in values.items():
            attempt.say("metrics", step=step, values={"eval/episode_reward": value})
        ids.append(attempt.id)
    page = tab.open(f"#/compare?ids={','.join(ids)}")
    page.get_by_label("Seeds as a band").check()
    # 100: 10, 30, 20; 200: (10 + 30) / 2 and 60; 300: 30 and 50.
    mean = "try 1 and 2 more seeds, mean: last 40 at 300, least 20, greatest 40"
    expect(page.get_by_role("img", name=mean)).to_be_visible()
    assert "seeds=band" in page.url
    assert tab.violations() == []
    tab.picture("compare-band")


@pytest.mark.extra
def test_what_is_compared_is_exported(tab: Tab, pair: list[Attempt], tmp_path: Path) -> None:
    page = tab.open(f"#/compare?ids={pair[0].id},{pair[1].id}&metric=eval/episode_reward")
    expect(page.get_by_role("img", name="seed 2: last 400 at 200")).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("button", name="Export CSV").click()
    download.value.save_as(tmp_path / "curves.csv")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "curves.csv").read_text())))
    found = [(row["name"], row["step"], row["eval/episode_reward"]) for row in rows]
    assert found == [
        ("seed 1", "100", "100"),
        ("seed 1", "200", "200"),
        ("seed 2", "100", "200"),
        ("seed 2", "200", "400"),
    ]
    with page.expect_download() as download:
        page.get_by_role("button", name="Export PNG").click()
    download.value.save_as(tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.extra
def test_a_picture_of_many_curves_names_them_in_their_colours(
    stack: Stack, make_tab: MakeTab, tmp_path: Path
) -> None:
    attempts = [
        Attempt(stack, job(f"{number:012x}-0000000000", name=f"layers of {number} neurons"))
        for number in range(10)
    ]
    for number, attempt in enumerate(attempts):
        for step in (0, 100, 200):
            attempt.say("metrics", step=step, values={"eval/episode_reward": step * (number + 1.0)})
    for width, dark in ((1280, False), (380, True)):
        tab = make_tab(width, dark)
        page = tab.open(f"#/compare?ids={','.join(attempt.id for attempt in attempts)}")
        chart = page.get_by_role("group", name="eval/episode_reward")
        # The axis's own row, and one for each line.
        expect(chart.locator(".u-series")).to_have_count(11)
        assert (tab.violations(), tab.overflow()) == ([], 0)
        tab.picture(f"compare-many-{width}")
        with page.expect_download() as download:
            page.get_by_role("button", name="Export PNG").click()
        path = tmp_path / f"compare-png-{width}.png"
        download.value.save_as(path)
        with av.open(str(path)) as container:
            pixels = next(container.decode(video=0)).to_ndarray(format="rgb24")
        box = chart.locator("canvas").bounding_box()
        assert box is not None
        plotted = 44 + round(box["height"])  # Below the title.
        assert pixels.shape[1] == round(box["width"]) + 48
        ground = pixels[2, 2]
        assert tuple(ground) == ((29, 32, 36) if dark else (255, 255, 255))
        title, below = pixels[:44], pixels[plotted:]
        assert (title != ground).any()
        assert (pixels[44:plotted, :34] != ground).any()  # The name of the upward axis.
        assert (below[:20] != ground).any()  # The name of the other one.
        for number in range(1, 9):
            ink = page.evaluate(
                """name => {
                  const probe = document.querySelector("main");
                  probe.style.color = `var(--curve-${name})`;
                  return getComputedStyle(probe).color.match(/[0-9]+/g).map(Number);
                }""",
                number,
            )
            # 22 by 4 pixels, and for the first two once more, dashed, of the ninth and the tenth job.
            assert (below[20:] == ink).all(axis=2).sum() == 88 + (72 if number < 3 else 0)


def film(path: Path, num_frames: int, shade: int) -> bytes:
    """Ten frames a second."""
    with Mp4Writer(path, width=160, height=120, fps=10) as video:
        for number in range(num_frames):
            video.write(np.full((120, 160, 3), (shade, 10 * number, 0), np.uint8))
    return path.read_bytes()


@pytest.mark.extra
def test_videos_that_are_compared_follow_one_clock(tab: Tab, pair: list[Attempt], tmp_path: Path) -> None:
    """The first job's last 1 s and 2 s, the second's 3 s and 1.5 s, at two checkpoints."""
    for attempt, lengths in zip(pair, ((10, 20), (30, 15)), strict=True):
        for step, num_frames in zip((100, 200), lengths, strict=True):
            body = film(tmp_path / "film.mp4", num_frames, 100 + num_frames)
            attempt.keep(f"video-{step}.mp4", body, step=step)
    page = tab.open(f"#/compare?ids={pair[0].id},{pair[1].id}")
    films = page.get_by_role("region", name="Videos in step")
    expect(films.get_by_text("0.00 s of 2.00 s")).to_be_visible()

    def expect_times(*expected: float) -> None:
        """To a tenth of a frame: Chromium's clock of a paused video may differ a bit from a seek's goal."""
        page.wait_for_function(
            """expected => [...document.querySelectorAll("video")].every(
              (video, i) => video.paused && Math.abs(video.currentTime - expected[i]) < 0.01)""",
            arg=expected,
        )

    films.get_by_label("Speed").select_option("0.5")
    films.get_by_role("button", name="Play all").click()
    # In step while they play; the longer one, which leads, plays at the speed that was chosen.
    page.wait_for_function(
        """() => {
          const [first, second] = document.querySelectorAll("video");
          return first.currentTime > 0.4 && first.playbackRate === 0.5 && !second.paused
            && Math.abs(first.currentTime - second.currentTime) < 0.05;
        }"""
    )
    films.get_by_role("button", name="Pause all").click()
    page.wait_for_function(
        """() => {
          const [first, second] = document.querySelectorAll("video");
          return first.paused && second.paused && first.currentTime > 0.3
            && Math.abs(Math.min(first.currentTime, second.duration) - second.currentTime) < 0.01;
        }"""
    )
    # Beyond its end the shorter one holds its last picture.
    films.get_by_role("slider", name="Moment").fill("1.8")
    expect_times(1.8, 1.5)
    # At the other checkpoint the second job's is the longer one: the moment stays.
    films.get_by_role("slider", name="Up to step 200").fill("0")
    expect(films.get_by_text("1.80 s of 3.00 s")).to_be_visible()
    expect_times(1.0, 1.8)
    films.get_by_label("Speed").select_option("2")
    films.get_by_role("button", name="Play all").click()
    # After the longest one's end both begin again.
    page.wait_for_function(
        """() => {
          const [first, second] = document.querySelectorAll("video");
          return second.currentTime > 0.2 && second.currentTime < 0.9
            && Math.abs(first.currentTime - second.currentTime) < 0.1;
        }"""
    )
    assert tab.violations() == []
    tab.picture("compare-films")


@pytest.mark.extra
def test_a_job_that_is_gone_does_not_hide_the_others(tab: Tab, pair: list[Attempt]) -> None:
    page = tab.open(f"#/compare?ids={pair[0].id},0000000000ff-0000000000")
    expect(page.get_by_text("Not there (any more): 0000000000ff-0000000000")).to_be_visible()
    expect(page.get_by_role("heading", name="Compare 1 job")).to_be_visible()


def test_a_form_from_the_schemas_submits_and_shows_refusals_in_place(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/submit")
    page.get_by_label("Environment", exact=True).select_option("inverted_pendulum")
    rate = page.get_by_label("learning rate", exact=True)
    # What is tuned for the environment stands there in grey.
    expect(page.get_by_label("num timesteps")).to_have_attribute("placeholder", "500000")
    page.get_by_label("name", exact=True).fill("by hand")
    page.get_by_label("labels", exact=True).fill('{"project": "balance"}')
    page.get_by_label("num envs", exact=True).fill("-3")
    page.get_by_role("button", name="Submit", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("/algorithm/num_envs")
    expect(page.get_by_label("num envs", exact=True)).to_have_attribute("aria-invalid", "true")
    assert rate.count() == 1
    page.get_by_label("num envs", exact=True).fill("64")
    # 9.3: what is corrected is no longer called wrong.
    expect(page.get_by_label("num envs", exact=True)).not_to_have_attribute("aria-invalid", "true")
    expect(page.get_by_role("alert")).to_have_text(
        "It was not submittedAll that was refused has been changed since."
    )
    expect(page.get_by_role("region", name="The submission as JSON")).to_contain_text('"num_envs": 64')
    page.get_by_role("button", name="Submit", exact=True).click()
    expect(page.get_by_role("heading", name="by hand")).to_be_visible()
    [stored] = stack.http.get("/jobs").json()["items"]
    assert stored["spec"] == {
        "kind": "train",
        "name": "by hand",
        "labels": {"project": "balance"},
        "environment": {"id": "inverted_pendulum"},
        "algorithm": {"num_envs": 64},
    }


@pytest.mark.extra
def test_the_same_submission_for_curl_and_for_python(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/submit?environment=ant")
    page.get_by_label("name", exact=True).fill('it\'s "quoted"')
    page.get_by_label("seed", exact=True).fill("7")
    page.get_by_role("button", name="curl").click()
    words = shlex.split(page.get_by_role("region", name="The submission as curl").inner_text())
    expected = {"kind": "train", "environment": {"id": "ant"}, "name": 'it\'s "quoted"', "seed": 7}
    assert json.loads(words[words.index("-d") + 1]) == expected
    assert f"http://127.0.0.1:{stack.port}/jobs" in words
    page.get_by_role("button", name="Python").click()
    tree = ast.parse(page.get_by_role("region", name="The submission as Python").inner_text())
    [call] = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "client.submit"
    ]
    assert ast.literal_eval(call.args[0]) == expected


@pytest.mark.extra
def test_a_job_is_run_again_as_it_was_sent(stack: Stack, tab: Tab, pair: list[Attempt]) -> None:
    page = tab.open(f"#/jobs/{pair[1].id}")
    page.get_by_role("link", name="Run again").click()
    page.get_by_role("button", name="Submit", exact=True).click()
    expect(page.get_by_role("heading", name="seed 2")).to_be_visible()
    first, second = stack.http.get("/jobs?name=seed+2").json()["items"]
    assert first["spec"] == second["spec"]


@pytest.mark.extra
def test_models_and_workers_come_page_by_page_and_jobs_wait_for_all_workers(stack: Stack, tab: Tab) -> None:
    """Of 51 workers, the last is free: the job waits because others come first, whichever page is shown."""
    for number in range(51):
        sent = NOON + timedelta(seconds=number)
        stack.store.announce(
            WorkerInfo(
                name=f"w{number:02}",
                host="h",
                pid=1,
                device="cpu",
                queues=queue_names("cpu"),
                job=None if number == 50 else f"{number:012x}-0000000000",
                started_at=sent,
                seen_at=sent,
            ),
            timedelta(minutes=1),
        )
        record = ModelRecord(
            id=f"sha256:{number:064x}", status="ready", media_type="application/xml", size=7, created_at=sent
        )
        stack.store.models.add(record)
    stack.store.add(job())
    page = tab.open("#/workers")
    expect(page.get_by_role("heading", level=2)).to_have_count(51)  # 50 workers, and the queue
    expect(page.get_by_role("region", name="Queue")).to_contain_text("Jobs before it come first.")
    page.get_by_role("link", name="More workers").click()
    expect(page.get_by_role("heading", name="w50")).to_be_visible()
    expect(page.get_by_role("heading", level=2)).to_have_count(2)
    page.get_by_role("link", name="First workers").click()
    expect(page.get_by_role("heading", name="w00")).to_be_visible()
    page = tab.open("#/models")
    expect(page.get_by_text(f"sha256:{50:064x}")).to_be_visible()
    page.get_by_role("link", name="Older models").click()
    expect(page.get_by_text(f"sha256:{0:064x}")).to_be_visible()
    expect(page.get_by_role("link", name="Train it")).to_have_count(1)


@pytest.mark.extra
def test_a_worker_that_trains_two_jobs_together_links_both(
    stack: Stack, tab: Tab, pair: list[Attempt]
) -> None:
    ids = sorted(attempt.id for attempt in pair)
    worker = WorkerInfo(
        name="worker-1", host="h", pid=1, device="gpu:0", job=ids[0], started_at=NOON, seen_at=NOON
    )
    stack.store.announce(worker, timedelta(minutes=1))
    page = tab.open("#/workers")
    expect(page.get_by_text(f"runs 2 jobs: {ids[0]}, {ids[1]}", exact=True)).to_be_visible()
    page.get_by_role("link", name=ids[1]).click()
    expect(page.get_by_role("heading", name="seed")).to_be_visible()


def test_a_gpu_that_jobs_share_says_so_on_the_cards_of_its_workers_and_on_the_pages_of_the_jobs(
    stack: Stack, tab: Tab
) -> None:
    jobs = [job(), job("019aa3c2f0b2-5be0c1d2e3")]
    for seat, queued in enumerate(jobs):
        name, seen = f"node1:gpu:0:00000{seat}", {"started_at": NOON, "seen_at": utc_now()}
        said = {"device": "gpu:0", "pool": "gpu:0", "seats": 2, "seat": seat, "host": "node1", "pid": 1}
        worker = WorkerInfo.model_validate({"name": name, **said, **seen})
        stack.store.announce(worker, timedelta(minutes=1))
        stack.store.add(queued)
        claimed = queued.claimed(name, NOON, details={"gpus": "gpu:0"}, gpu_part=0.25)
        stack.store.save(claimed, lease=timedelta(minutes=1))
    stack.store.save(stack.store.get(jobs[0].id).noted(peak_bytes=3 * 10**9))
    page = tab.open("#/workers")
    first, second = (page.locator("section.card").filter(has_text=f"node1:gpu:0:00000{n}") for n in (0, 1))
    expect(first).to_contain_text(f"Sharesits GPU with {jobs[1].id}")
    expect(second).to_contain_text("only for jobs that share it")
    page = tab.open(f"#/jobs/{jobs[0].id}")
    attempts = page.get_by_role("region", name="Attempts")
    expect(attempts).to_contain_text("shares the GPU: 25 % of its memory")
    expect(attempts).to_contain_text("of memory at most")


def test_a_gpu_that_is_lent_says_to_whom_and_is_busy(stack: Stack, tab: Tab) -> None:
    ago, pool = utc_now() - timedelta(hours=2), {"pool": "gpu:0,1", "host": "node1", "pid": 1}
    stack.store.add(queued := job())
    claimed = queued.claimed("node1:gpu:0:a1b2c3", ago, details={"gpus": "gpu:0,1"})
    stack.store.save(claimed, lease=timedelta(minutes=1))
    says_who = f"The job {queued.id} has its GPU: it runs on gpu:0,1 of this machine."
    for gpu, said in enumerate(({}, {"state": "lent", "problem": says_who})):
        name, device = f"node1:gpu:{gpu}:a1b2c3", f"gpu:{gpu}"
        seen = {"started_at": ago, "seen_at": utc_now()}
        worker = WorkerInfo.model_validate({"name": name, "device": device, **pool, **seen, **said})
        stack.store.announce(worker, timedelta(minutes=1))
    page = tab.open("#/workers")
    owner, lender = (page.locator("section.card").filter(has_text=f"node1:gpu:{gpu}:") for gpu in (0, 1))
    expect(owner).to_contain_text(f"runs {queued.id}")
    expect(lender).to_contain_text(f"lent: {says_who}")
    expect(lender).to_contain_text("gpu:1 of gpu:0,1, which jobs share out")
    for card in (owner, lender):
        expect(card.get_by_role("img", name=re.compile("busy for [89] % of the last day"))).to_be_visible()
    owner.get_by_role("link", name=queued.id).click()
    expect(page.get_by_text("on gpu:0,1", exact=True)).to_be_visible()


def test_the_http_interface_is_there_without_another_network(tab: Tab) -> None:
    page = tab.open("docs")
    expect(page.get_by_text("/jobs/{job_id}/cancel", exact=True)).to_be_visible()
    page.get_by_role("button", name="GET /jobs List Jobs", exact=False).first.click()
    expect(page.get_by_text("Jobs, newest first").first).to_be_visible()
    # 9.7: it had no dark colours and no way back.
    page.get_by_role("button", name="Dark").click()
    expect(page.locator("html.dark-mode")).to_have_count(1)
    page.get_by_role("link", name="Gaitway").click()
    expect(page.get_by_role("button", name="Light")).to_be_visible()
    documentation = page.get_by_role("link", name="Docs")
    expect(documentation).to_have_attribute("href", re.compile("/docs/training.md$"))


VIEWS = [
    "#/jobs",
    "#/jobs/{id}",
    "#/jobs/{id}/curves?smooth=0.5",
    "#/jobs/{id}/log",
    "#/jobs/{id}/files",
    "#/jobs/{id}/specification",
    "#/compare?ids={id},{other}",
    "#/submit",
    "#/models",
    "#/workers",
    "#/usage",
    "#/news?webhook=lab-chat",
]


def test_usage_is_shown_by_project_and_device(stack: Stack, tab: Tab) -> None:
    ago = utc_now() - timedelta(hours=2)
    stack.store.add(queued := job())
    stack.store.save(queued.claimed("node1:gpu:0,1:a1b2c3", ago), lease=timedelta(minutes=1))
    page = tab.open("#/usage")
    row = page.get_by_role("region", name="By project and user").get_by_role("row").filter(has_text="default")
    # Two hours on two GPUs.
    expect(row).to_contain_text("4")
    device = page.get_by_role("region", name="By device").get_by_role("row").filter(has_text="node1")
    # Two of the 23 to 24 hours that the last day's hours have so far.
    busy = re.compile("node1, gpu:0,1: busy for [89] % of the last day")
    expect(device.get_by_role("img", name=busy)).to_be_visible()
    page.get_by_role("combobox", name="In").select_option("the last 30 days")
    expect(row).to_contain_text("4")
    assert "days=30" in page.url


def tell_of(stack: Stack, job_id: str) -> None:
    """Let a webhook be told of the job, in vain."""
    store = stack.store
    answer = stack.http.post(
        "/projects/default/webhooks", json={"name": "lab-chat", "url": "https://1.1.1.1/long/path"}
    )
    assert answer.status_code == 201
    message = new_message("job.failed", utc_now(), {}, project="default", job=job_id)
    store.add_test("default", "lab-chat", message)
    (due,) = store.claim_deliveries(1, is_http=True)
    store.note_outcome(due, Outcome(error="It did not answer within 10 s."))


@pytest.mark.timeout(300)  # Half a minute, where nobody else is at work.
def test_every_view_is_accessible_and_fits(stack: Stack, tab: Tab, pair: list[Attempt]) -> None:
    pair[0].keep("video-100.mp4", step=100)
    pair[0].keep("checkpoint-100.msgpack", role="checkpoint", media_type="application/octet-stream", step=100)
    tell_of(stack, pair[0].id)
    for view in VIEWS:
        page = tab.open("")
        page = tab.open(view.format(id=pair[0].id, other=pair[1].id))
        expect(page.locator("main h1")).to_be_visible()
        expect(page.get_by_text("Loading")).to_have_count(0)
        name = view.partition("?")[0].strip("#/").replace("/", "-").replace("{id}", "one")
        tab.picture(f"{name}-1280")
        assert (view, flaws(page)) == (view, [])
        tab.picture(f"{name}-380")
        page.set_viewport_size({"width": 1280, "height": 900})
        page.emulate_media(color_scheme="light")


@pytest.mark.extra
def test_the_reader_chooses_light_or_dark(tab: Tab) -> None:
    page = tab.open()
    ground = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(ground)
    page.get_by_role("button", name="Dark").click()
    assert page.evaluate(ground) != light
    page.reload()
    expect(page.get_by_role("button", name="Light")).to_be_visible()
    assert page.evaluate(ground) != light


@pytest.mark.extra
def test_a_view_that_an_outage_kept_away_comes_when_it_is_over(tab: Tab) -> None:
    page = tab.open("#/jobs")
    expect(page.get_by_role("heading", name="Jobs")).to_be_visible()
    page.context.set_offline(True)
    page.get_by_role("link", name="Workers").click()
    expect(page.get_by_role("alert")).to_contain_text("The service does not answer.")
    page.context.set_offline(False)
    expect(page.get_by_role("heading", name="Workers")).to_be_visible()


@pytest.mark.extra
def test_an_address_of_nowhere_leads_back(tab: Tab) -> None:
    page = tab.open("#/nowhere")
    expect(page.get_by_text("There is no page “nowhere”.")).to_be_visible()
