"""The page of an ended sweep: a form to resume it, and a link to start one like it."""

import json
from typing import Any

import pytest
from playwright.sync_api import expect

from core.jobs.status import JobStatus
from core.reasons import Reason
from core.sweeps.controller import SweepController
from tests.api.conftest import Attempt, Stack
from tests.api.pages.conftest import MakeTab, Tab

RATE = "algorithm.learning_rate"


@pytest.fixture
def ended(stack: Stack) -> dict[str, Any]:
    """A sweep of two random trials, which have ended, and so has it."""
    said = {
        "name": "two draws",
        "job": {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 1000}},
        "method": "random",
        "parameters": {RATE: {"low": 1e-4, "high": 1e-2, "log": True}},
        "budget": {"jobs": 2, "parallel": 2},
    }
    found = stack.http.post("/sweeps", json=said).json()
    controller = SweepController(stack.store, stack.queue, stack.objects)
    controller.run_once()
    for trial in stack.store.trials([found["id"]])[found["id"]]:
        Attempt(stack, stack.store.get(trial.job or ""), is_new=False).end(JobStatus.FAILED, Reason.DIVERGED)
    controller.run_once()
    controller.run_once()
    return stack.http.get(found["links"]["self"]).json()


def test_an_ended_sweep_is_resumed_under_another_budget(
    stack: Stack, tab: Tab, ended: dict[str, Any]
) -> None:
    assert ended["status"] == "succeeded"
    page = tab.open(f"#/sweeps/{ended['id']}")
    expect(page.get_by_role("button", name="Cancel")).to_have_count(0)
    page.get_by_text("Resume under another budget").click()
    expect(page.get_by_text("2 trials with 0 steps")).to_be_visible()
    expect(page.get_by_label("jobs", exact=True)).to_have_value("2")
    page.get_by_role("button", name="Resume", exact=True).click()
    expect(page.get_by_text("Its budget of jobs is used, so no further trial would start")).to_be_visible()
    assert tab.violations() == []
    page.get_by_label("jobs", exact=True).fill("5")
    page.get_by_label("steps", exact=True).fill("1")
    page.get_by_role("button", name="Resume", exact=True).click()
    expect(page.get_by_label("steps", exact=True)).to_have_attribute("aria-invalid", "true")
    page.get_by_label("steps", exact=True).fill("")
    page.get_by_role("button", name="Resume", exact=True).click()
    expect(page.get_by_role("button", name="Cancel")).to_be_visible()
    expect(page.get_by_text("Resume under another budget")).to_have_count(0)
    resumed = stack.http.get(ended["links"]["self"]).json()
    assert (resumed["status"], resumed["spec"]["budget"]["jobs"]) == ("running", 5)
    # And from there cancelled: nothing of it runs, so that is its end at the next look.
    page.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Yes, cancel").click()
    expect(page.get_by_text("cancelling").first).to_be_visible()
    SweepController(stack.store, stack.queue, stack.objects).run_once()
    expect(page.get_by_text("Resume under another budget")).to_be_visible()


@pytest.mark.extra
def test_a_sweep_like_another_is_written_from_its_page(tab: Tab, ended: dict[str, Any]) -> None:
    page = tab.open(f"#/sweeps/{ended['id']}")
    page.get_by_role("link", name="Start one like it").click()
    expect(page.get_by_role("heading", name="Start a sweep")).to_be_visible()
    found = json.loads(page.get_by_role("region", name="The submission as JSON").inner_text())
    assert found["parameters"] == {RATE: {"low": 1e-4, "high": 1e-2, "log": True}}
    assert found["budget"] == {"jobs": 2, "parallel": 2}
    assert found["job"]["algorithm"] == {"num_timesteps": 1000}


@pytest.mark.extra
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1200, 380])
def test_the_form_is_accessible_and_fits(
    make_tab: MakeTab, ended: dict[str, Any], width: int, dark: bool
) -> None:
    tab = make_tab(width, dark)
    page = tab.open(f"#/sweeps/{ended['id']}")
    page.get_by_text("Resume under another budget").click()
    expect(page.get_by_label("jobs", exact=True)).to_be_visible()
    assert (tab.violations(), tab.overflow()) == ([], 0)
    tab.picture(f"resume-{width}-{'dark' if dark else 'light'}")
