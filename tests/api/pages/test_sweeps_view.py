"""Sweeps on the page: the list, and one sweep with its pictures, its trials, and its cancel."""

from typing import Any

import pytest
from playwright.sync_api import expect

from core.jobs.job import Progress
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.sweeps.controller import SweepController
from tests.api.conftest import Attempt, Stack
from tests.api.pages.conftest import MakeTab, Tab

METRIC = "eval/episode_reward"
SWEEP = {
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
    controller.look()
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
    controller.look()
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


def test_a_population_shows_generations_and_parents(stack: Stack, tab: Tab) -> None:
    population = {
        "job": {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 10**8}},
        "method": "pbt",
        "parameters": {"algorithm.entropy_cost": {"low": 0.0, "high": 0.1}},
        "population": {"size": 2, "generations": 2},
    }
    found = stack.http.post("/sweeps", json=population).json()
    controller = SweepController(stack.store, stack.queue, stack.objects)
    controller.look()
    for trial in stack.store.trials([found["id"]])[found["id"]]:
        attempt = Attempt(stack, stack.store.get(trial.job or ""), is_new=False)
        progress = Progress(step=5, total=5, metrics={METRIC: float(trial.number)})
        stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
        attempt.keep("checkpoint-5", role="checkpoint", step=5)
        attempt.end()
    controller.look()
    page = tab.open(f"#/sweeps/{found['id']}")
    rows = page.get_by_role("region", name="Trials").get_by_role("row")
    expect(rows).to_have_count(5)
    texts = [text.split("\t")[1:4] for text in rows.all_inner_texts()]
    assert texts == [
        ["Trial", "Generation", "Resumed from"],
        ["trial 1", "0", ""],
        ["trial 0", "0", ""],
        ["trial 2", "1", "trial 1"],
        ["trial 3", "1", "trial 1"],
    ]
    assert tab.violations() == []


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


def test_without_sweeps_the_page_says_how_to_begin(tab: Tab) -> None:
    page = tab.open("#/sweeps")
    expect(page.get_by_text("No sweeps yet.")).to_be_visible()
    page = tab.open("#/sweeps/019aa3c2f0b1-5be0c1d2e3")
    expect(page.get_by_role("alert")).to_contain_text("There is no sweep '019aa3c2f0b1-5be0c1d2e3'.")


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
