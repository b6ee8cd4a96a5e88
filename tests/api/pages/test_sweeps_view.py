"""Sweeps on the page: the list, and one sweep with its pictures, its trials, and its cancel."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import expect

from core.jobs.job import Progress
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.rendering.mp4 import write_png
from core.sweeps.controller import SweepController
from core.sweeps.sweep import Trial
from tests.api.conftest import Attempt, Stack
from tests.api.pages.conftest import MakeTab, Tab

METRIC = "eval/episode_reward"
SWEEP: dict[str, Any] = {
    "name": "rates <b>and</b> seeds",
    "labels": {"project": "gaits"},
    "job": {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 1000}, "video": None},
    "method": "grid",
    "parameters": {
        "algorithm.learning_rate": {"low": 1e-4, "high": 1e-2, "log": True, "points": 3},
        "algorithm.policy_hidden_layer_sizes": [[32, 32], [64]],
        "seed": [1, 2],
    },
    "budget": {"parallel": 12},
}


@pytest.fixture
def sweep(stack: Stack) -> dict[str, Any]:
    """Twelve trials: nine succeeded, one failed, one runs, one waits."""
    found = stack.http.post("/sweeps", json=SWEEP).json()
    controller = SweepController(stack.store, stack.queue, stack.objects)
    controller.run_once()
    for number, trial in enumerate(stack.store.trials([found["id"]])[found["id"]][:11]):
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        value = 100.0 * (number // 4) + 7 * (number % 4)
        progress = Progress(step=1000, total=1000, metrics={METRIC: value})
        attempt.say("metrics", step=1000, values={METRIC: value})
        stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
        if number < 9:
            attempt.end()
        elif number == 9:
            attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    controller.run_once()
    return found


def test_a_sweep_shows_what_came_of_its_trials(tab: Tab, sweep: dict[str, Any]) -> None:
    page = tab.open("#/sweeps")
    row = page.get_by_role("row").filter(has_text="rates <b>and</b> seeds")
    expect(row).to_contain_text("12 of 12")
    expect(row).to_contain_text("200")
    row.get_by_role("link").click()
    expect(page.get_by_role("heading", name="rates <b>and</b> seeds")).to_be_visible()
    expect(page.get_by_role("img", name=f"{METRIC}: the best of 9 trials is 200")).to_be_visible()
    expect(page.get_by_role("img", name=f"Settings and {METRIC} of 11 trials")).to_be_visible()
    shares = page.get_by_role("listitem").filter(has_text="algorithm.learning_rate")
    expect(shares).to_contain_text("%")
    rows = page.get_by_role("region", name="Trials").get_by_role("row")
    # The one that runs has 214 so far; the best that succeeded has 200.
    assert [text.split("\t")[1] for text in rows.all_inner_texts()[1:4]] == ["trial 10", "trial 9", "trial 8"]
    # Seeds 1 and 2 of the first setting: 0 and 7 have the mean 3.5.
    groups = page.get_by_role("region", name="Seeds of one setting together")
    expect(groups.get_by_role("cell", name="3.5 ± 4.95", exact=True)).to_have_count(1)


DISTANCE = "eval/episode_distance_from_origin"


@pytest.mark.extra
def test_of_several_objectives_one_is_chosen_and_the_front_is_marked(stack: Stack, make_tab: MakeTab) -> None:
    """Trials 0 to 5 have the returns 0 to 50 and distances of which 0, 2, 3 and 5 are not beaten in both."""
    sweep, controller = begun(
        stack,
        parameters={"algorithm.learning_rate": [1e-4, 1e-3, 1e-2], "seed": [1, 2]},
        objective=[
            {"metric": METRIC, "direction": "maximize"},
            {"metric": DISTANCE, "direction": "minimize"},
        ],
    )
    for trial, distance in zip(
        stack.store.trials([sweep["id"]])[sweep["id"]], (1, 4, 3, 5, 9, 8), strict=True
    ):
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        values = {METRIC: 10.0 * trial.number, DISTANCE: float(distance)}
        for step in (500, 1000):
            attempt.say("metrics", step=step, values={name: value * step for name, value in values.items()})
        progress = Progress(step=1000, total=1000, metrics=values)
        stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
        attempt.end()
    controller.run_once()
    for width, dark in ((1280, False), (380, True)):
        tab = make_tab(width, dark)
        page = tab.open(f"#/sweeps/{sweep['id']}")
        front = page.get_by_role(
            "img", name=f"{DISTANCE} over {METRIC} of 6 trials, of which 4 are the front"
        )
        expect(front.locator("circle.best")).to_have_count(4)
        assert front.locator(".tick").all_text_contents() == ["0", "2", "3", "5"]
        # An axis for the setting, the seed, and each objective.
        parallel = page.get_by_role("img", name=f"Settings and {METRIC}, {DISTANCE} of 6 trials")
        expect(parallel.locator("line")).to_have_count(4)
        expect(page.get_by_role("img", name=f"{METRIC}: the best of 6 trials is 50")).to_be_visible()
        groups = page.get_by_role("region", name="Seeds of one setting together")
        expect(groups.get_by_role("row").nth(1)).to_contain_text("45 ± 7.071")
        first = page.get_by_role("region", name="Trials").get_by_role("row").nth(1)
        expect(first).to_contain_text("trial 5")
        page.get_by_label("Objective of what follows").select_option(DISTANCE)
        expect(page.get_by_role("img", name=f"{DISTANCE}: the best of 6 trials is 1")).to_be_visible()
        expect(groups.get_by_role("row").nth(1)).to_contain_text("2.5 ± 2.121")
        # At step 1000 the seeds of the first setting report 1000 and 4000.
        bands = (
            f"{DISTANCE}. learning_rate 1e-4, mean of 2 seeds: last 2500 at 1K, least 1250, greatest 2500."
        )
        groups.scroll_into_view_if_needed()
        expect(page.get_by_role("img", name=bands)).to_be_visible()
        expect(first).to_contain_text("trial 0")
        first.scroll_into_view_if_needed()
        expect(page.get_by_role("img", name="Trial 0, from 500 to 1000", exact=True)).to_be_visible()
        page.get_by_label("Across").select_option(DISTANCE)
        expect(page.get_by_role("img", name=f"{DISTANCE} over {DISTANCE}")).to_be_visible()
        page.get_by_label("Up").select_option(METRIC)
        expect(page.get_by_role("img", name=f"{METRIC} over {DISTANCE}")).to_be_visible()
        assert "objective=" in page.url
        assert (tab.violations(), tab.overflow()) == ([], 0)
        tab.picture(f"sweep-objectives-{width}")


@pytest.mark.extra
def test_a_population_shows_generations_and_parents(stack: Stack, tab: Tab) -> None:
    population = {
        "job": {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 10**8}},
        "method": "pbt",
        "parameters": {"algorithm.entropy_cost": {"low": 0.0, "high": 0.1}},
        "population": {"size": 2, "generations": 2},
    }
    found = stack.http.post("/sweeps", json=population).json()
    controller = SweepController(stack.store, stack.queue, stack.objects)
    controller.run_once()
    for trial in stack.store.trials([found["id"]])[found["id"]]:
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        progress = Progress(step=5, total=5, metrics={METRIC: float(trial.number)})
        stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
        attempt.keep("checkpoint-5", role="checkpoint", step=5)
        attempt.end()
    controller.run_once()
    page = tab.open(f"#/sweeps/{found['id']}")
    rows = page.get_by_role("region", name="Trials").get_by_role("row")
    expect(rows).to_have_count(5)
    # Between the trial and its generation are its curve and its video.
    cells = [[cell.strip() for cell in text.split("\t")] for text in rows.all_inner_texts()]
    assert [[*row[1:2], *row[4:6]] for row in cells] == [
        ["Trial", "Generation", "Resumed from"],
        ["trial 1", "0", ""],
        ["trial 0", "0", ""],
        ["trial 2", "1", "trial 1"],
        ["trial 3", "1", "trial 1"],
    ]
    assert tab.violations() == []


def begun(stack: Stack, **changes: Any) -> tuple[dict[str, Any], SweepController]:
    found = stack.http.post("/sweeps", json=SWEEP | changes).json()
    controller = SweepController(stack.store, stack.queue, stack.objects)
    controller.run_once()
    return found, controller


def train(stack: Stack, trial: Trial) -> Attempt:
    """Report a curve from 0 to the trial's number, at step 1000."""
    attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
    attempt.say_all(
        "metrics", [{"step": 500 * end, "values": {METRIC: trial.number * end / 2}} for end in (0, 1, 2)]
    )
    progress = Progress(step=1000, total=1000, metrics={METRIC: float(trial.number)})
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
    return attempt


@pytest.mark.extra
def test_each_trial_shows_its_curve_and_its_video(stack: Stack, make_tab: MakeTab, tmp_path: Path) -> None:
    write_png(tmp_path / "poster.png", np.full((48, 64, 3), 120, np.uint8))
    poster = (tmp_path / "poster.png").read_bytes()
    job = {key: value for key, value in SWEEP["job"].items() if key != "video"}
    sweep, controller = begun(stack, job=job, parameters={"seed": [1, 2, 3]})
    trials = stack.store.trials([sweep["id"]])[sweep["id"]]
    first = train(stack, trials[0])
    second = train(stack, trials[1])
    second.keep("poster-1000.png", poster, role="poster", media_type="image/png", step=1000)
    second.end()
    controller.run_once()
    for width in (1280, 380):
        tab = make_tab(width)
        page = tab.open(f"#/sweeps/{sweep['id']}")
        rows = page.get_by_role("region", name="Trials").get_by_role("row")
        best = rows.nth(1)
        best.scroll_into_view_if_needed()
        expect(best.get_by_role("img", name="Trial 1, from 0 to 1", exact=True)).to_be_visible()
        image = best.locator(".thumbnail img")
        best.locator(".poster").scroll_into_view_if_needed()  # At 380 pixels it is beyond the table's edge.
        expect(image).to_be_visible()
        assert image.evaluate("image => image.decode().then(() => image.naturalWidth)") == 64
        rows.last.scroll_into_view_if_needed()
        expect(page.locator(".trials svg")).to_have_count(2)
        expect(page.locator(".thumbnail")).to_have_count(1)
        assert (tab.violations(), tab.overflow()) == ([], 0)
        tab.picture(f"sweep-curves-{width}")
    # A trial that runs shows its video as soon as it has one.
    first.keep("poster-1000.png", poster, role="poster", media_type="image/png", step=1000)
    first.end()
    expect(rows.filter(has_text="trial 0").locator(".thumbnail img")).to_be_visible()


@pytest.mark.extra
def test_seeds_that_one_job_trains_are_a_band(stack: Stack, make_tab: MakeTab) -> None:
    job = {**SWEEP["job"], "resources": {"accelerator": "gpu"}}
    for parameters in ({"algorithm.learning_rate": [1e-4, 1e-3], "seed": [1, 2]}, {"seed": [1, 2]}):
        sweep, controller = begun(stack, name=None, job=job, parameters=parameters)
        for trial in stack.store.trials([sweep["id"]])[sweep["id"]]:
            attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
            for step in (500, 1000):
                own = {f"seed_{seed}/{METRIC}": 10.0 * seed for seed in (1, 2)}
                attempt.say("metrics", step=step, values={METRIC: 15.0, **own})
            progress = Progress(step=1000, total=1000, metrics={METRIC: 15.0})
            stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
            attempt.end()
        controller.run_once()
        tab = make_tab()
        page = tab.open(f"#/sweeps/{sweep['id']}")
        groups = page.get_by_role("region", name="Seeds of one setting together")
        expect(groups.get_by_role("row").nth(1)).to_contain_text("215")  # Two seeds, and their mean
        page.locator(".bands").scroll_into_view_if_needed()
        expect(page.get_by_role("img", name=re.compile("mean of 2 seeds: last 15 at 1"))).to_be_visible()
        assert tab.violations() == []


@pytest.mark.slow
def test_of_many_trials_those_in_sight_load_their_curves(stack: Stack, tab: Tab) -> None:
    sweep, controller = begun(stack, parameters={"seed": list(range(200))}, budget={"parallel": 100})
    for _ in range(2):
        controller.run_once()
        for trial in stack.store.trials([sweep["id"]])[sweep["id"]]:
            if trial.outcome is None:
                train(stack, trial).end()
    controller.run_once()
    asked = list[str]()
    tab.page.on("request", lambda request: asked.append(request.url))
    page = tab.open(f"#/sweeps/{sweep['id']}")
    rows = page.get_by_role("region", name="Trials").get_by_role("row")
    expect(rows).to_have_count(201)
    rows.nth(1).scroll_into_view_if_needed()
    expect(page.get_by_role("img", name="Trial 199, from 0 to 199", exact=True)).to_be_visible()
    # The best stand first; trial 0, whose curve is level, is the last one.
    rows.last.scroll_into_view_if_needed()
    expect(page.get_by_role("img", name="Trial 0, from 0 to 0", exact=True)).to_be_visible()
    # A window of 900 pixels shows fewer than 30 rows, and was at two places.
    curves = [url for url in asked if "/metrics" in url]
    assert len(set(curves)) == len(curves) < 60


@pytest.mark.extra
def test_trials_are_picked_and_compared(tab: Tab, sweep: dict[str, Any]) -> None:
    page = tab.open(f"#/sweeps/{sweep['id']}")
    for number in (0, 8):
        page.get_by_label(f"Compare trial {number}", exact=True).check()
    expect(page.locator("polyline.picked")).to_have_count(2)
    page.get_by_role("link", name="Compare", exact=True).click()
    expect(page.get_by_role("heading", name="Compare 2 jobs")).to_be_visible()


def test_a_sweep_is_cancelled_after_a_question(stack: Stack, tab: Tab, sweep: dict[str, Any]) -> None:
    page = tab.open(f"#/sweeps/{sweep['id']}")
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Yes, cancel").click()
    expect(page.get_by_text("cancelling").first).to_be_visible()
    assert stack.http.get(sweep["links"]["self"]).json()["status"] == "cancelling"


@pytest.mark.extra
def test_without_sweeps_the_page_says_how_to_begin(tab: Tab) -> None:
    page = tab.open("#/sweeps")
    expect(page.get_by_text("No sweeps yet.")).to_be_visible()
    page = tab.open("#/sweeps/019aa3c2f0b1-5be0c1d2e3")
    expect(page.get_by_role("alert")).to_contain_text("There is no sweep '019aa3c2f0b1-5be0c1d2e3'.")


@pytest.mark.extra
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (380, True)], ids=["desk", "phone"])
def test_both_views_are_accessible_and_fit(
    make_tab: MakeTab, sweep: dict[str, Any], width: int, dark: bool
) -> None:
    tab = make_tab(width, dark)
    for name, view in {"sweeps": "#/sweeps", "sweep": f"#/sweeps/{sweep['id']}?pick=3"}.items():
        page = tab.open("")
        page = tab.open(view)
        expect(page.locator("main h1")).to_be_visible()
        expect(page.get_by_text("Loading")).to_have_count(0)
        assert (view, tab.violations()) == (view, [])
        assert (view, tab.overflow()) == (view, 0)
        tab.picture(f"{name}-{width}")
