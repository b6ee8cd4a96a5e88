"""The page over the real service: submit by form, watch live, see videos, compare, fork, cancel, sweep."""

import json
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from gaitway.client import Client
from tests.api.pages.conftest import Tab, browser
from tests.e2e.watching import watching

__all__ = ["browser"]  # The fixture.

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]


@pytest.fixture
def tab(browser: Browser, client: Client) -> Tab:
    page = browser.new_page(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    page.set_default_timeout(240_000)
    return Tab(page, str(client.base_url).rstrip("/"))


def submit(page: Page, **said: str) -> None:
    for label, text in said.items():
        page.get_by_label(label.replace("_", " "), exact=True).fill(text)
    page.get_by_role("button", name="Submit", exact=True).click()


def test_a_job_from_the_form_to_its_fork(tab: Tab, client: Client) -> None:
    page = tab.open("#/submit?environment=inverted_pendulum")
    expect(page.get_by_role("img", name="inverted_pendulum, camera track")).to_be_visible(timeout=240_000)
    tab.picture("real-submit")
    page.get_by_text("video", exact=True).click()
    page.get_by_role("combobox", name="every checkpoint").select_option("true")
    page.get_by_text("checkpoints", exact=True).click()
    submit(page, name="from the form", num_timesteps="60000", every_steps="20000", width="160", height="120")
    expect(page.locator(".status")).to_have_text("running", timeout=240_000)
    # Live: the curve grows while somebody looks.
    expect(page.get_by_role("img", name="Return. eval: last")).to_be_visible(timeout=600_000)
    expect(page.get_by_role("slider", name="Video")).to_be_visible(timeout=600_000)
    expect(page.locator(".status")).to_have_text("succeeded", timeout=600_000)
    player = page.locator("video")
    page.wait_for_function("() => document.querySelector('video').readyState >= 2")
    assert player.evaluate("video => video.videoWidth") == 160
    tab.picture("real-job")
    first = page.url.rpartition("/")[2]

    # The trained policy in the browser's physics: a push moves the cart.
    page.get_by_role("link", name="Push", exact=True).click()
    expect(page.get_by_text("Take hold of the body and pull.")).to_be_visible()
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("() => document.querySelector('canvas').dataset.time > 0.5")
    page.get_by_role("button", name="Push it right").click()
    page.wait_for_function("() => document.querySelector('canvas').dataset.position.split(' ')[0] > 0.02")
    tab.picture("real-push")
    page.get_by_role("link", name="Overview").click()

    page.get_by_role("slider", name="Video").fill("0")
    page.get_by_role("link", name="Fork from this checkpoint").click()
    submit(page, num_timesteps="5000000")
    expect(page.locator(".status")).to_have_text("running", timeout=240_000)
    second = page.url.rpartition("/")[2]
    # Its first evaluation is far away; its updates are measured.
    expect(page.get_by_role("img", name="Return. training: last")).to_be_visible(timeout=600_000)
    assert client.get(second).attempts[0].details["resumed_at_step"] > 0
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Yes, cancel").click()
    expect(page.locator(".status")).to_have_text("cancelled", timeout=240_000)

    page = tab.open(f"#/compare?ids={first},{second}")
    table = page.get_by_role("region", name="Settings that differ")
    expect(table.get_by_role("row").filter(has_text="resume_from.step")).to_be_visible()
    # The fork may have been cancelled before its first video.
    expect(page.locator(".grid figure")).to_have_count(2)
    expect(page.locator("video").first).to_be_visible()
    tab.picture("real-compare")

    page = tab.open(f"#/jobs/{first}/replay")
    canvas = page.locator("canvas[data-pictures][data-shown]")
    expect(canvas).to_be_visible(timeout=240_000)
    at_first = canvas.screenshot()
    page.get_by_role("button", name="Play").click()
    moment = page.get_by_role("slider", name="Moment")
    page.wait_for_function("slider => slider.value > 0.3", arg=moment.element_handle())
    page.get_by_role("button", name="Pause").click()
    assert canvas.screenshot() != at_first
    tab.picture("real-replay")


def test_a_running_training_is_watched_and_pushed(tab: Tab, client: Client, tmp_path: Path) -> None:
    algorithm = {**JOB["algorithm"], "num_timesteps": 10**7, "num_evals": 2}
    job = client.submit({**JOB, "algorithm": algorithm, "checkpoints": {"every_steps": 50_000}})
    asked = tmp_path / "asked"
    with watching(client, job.id, asked) as watch:
        for event in client.events(job.id):
            if event.kind == "artifact" and event.data["role"] == "replay":
                break
        page = tab.page
        page.goto(asked.read_text().strip())
        expect(page.get_by_role("img", name="Replay of episode 1 at step")).to_be_visible()
        expect(page.locator("canvas[data-pictures][data-shown]")).to_be_visible()
        expect(page.locator(".status")).to_have_text("running")
        tab.picture("real-watched")
        page.get_by_role("link", name="Push it, and see whether it recovers").click()
        expect(page.get_by_text("Take hold of the body and pull.")).to_be_visible()
        page.get_by_role("button", name="Play").click()
        policy = page.get_by_text("Policy at step")
        first = policy.inner_text()
        expect(policy).not_to_have_text(first, timeout=240_000)
        page.get_by_role("button", name="Push it right").click()
        page.wait_for_function("() => document.querySelector('canvas').dataset.position.split(' ')[0] > 0.02")
        tab.picture("real-push-running")
        expect(page.locator(".status")).to_have_text("running")
        client.cancel(job.id)
        said, _ = watch.communicate(timeout=240)
    assert f"Job {job.id} cancelled" in said
    expect(page.get_by_text("the training's next one")).to_have_count(0)


# Its trials train for moments.
JOB = {
    "environment": "inverted_pendulum",
    "algorithm": {
        "num_timesteps": 9600,
        "num_envs": 32,
        "unroll_length": 10,
        "batch_size": 16,
        "num_minibatches": 2,
        "num_evals": 6,
        "num_eval_envs": 4,
        "episode_length": 100,
        "policy_hidden_layer_sizes": [16],
        "value_hidden_layer_sizes": [16],
    },
    "video": {"width": 160, "height": 120, "seconds": 2},
}


def test_a_sweep_from_the_form_to_its_trials(tab: Tab) -> None:
    page = tab.open("#/sweeps/new")
    page.get_by_role("button", name="Pasted JSON").click()
    page.get_by_label("A job or a whole sweep, as JSON").fill(json.dumps({"kind": "train", **JOB}))
    page.get_by_role("button", name="Take it").click()
    page.get_by_role("radio", name="grid", exact=False).check()
    page.get_by_label("Setting", exact=True).select_option("seed")
    page.get_by_role("button", name="Add the axis").click()
    page.get_by_role("group", name="seed", exact=True).get_by_label("values").fill("1, 2")
    page.get_by_label("name", exact=True).last.fill("two seeds")
    expect(page.get_by_role("status", name="Size")).to_contain_text("2 trials")
    tab.picture("real-new-sweep")
    page.get_by_role("button", name="Start the sweep").click()
    expect(page.get_by_role("heading", name="two seeds")).to_be_visible()
    trials = page.get_by_role("region", name="Trials").locator("tbody tr")
    expect(trials).to_have_count(2, timeout=240_000)
    expect(page.locator(".about-job .status")).to_have_text("succeeded", timeout=600_000)
    for trial in (trials.first, trials.last):
        expect(trial.locator(".status")).to_have_text("succeeded")
        trial.scroll_into_view_if_needed()
        expect(trial.locator(".spark polyline")).to_be_visible()
        expect(trial.locator(".thumbnail img")).to_be_visible()
    tab.picture("real-sweep")
