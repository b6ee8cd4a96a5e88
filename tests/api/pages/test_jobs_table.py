"""The table of jobs: its order, its columns, sweeps in it, and what is done with several jobs at once."""

import re

import pytest
from playwright.sync_api import Locator, Page, expect

from core.jobs.job import Job, Progress
from core.jobs.status import JobStatus
from core.sweeps.controller import SweepController
from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import Tab, flaws

METRIC = "eval/episode_reward"


def numbered(number: int, **spec: object) -> Job:
    return job(f"{number:012x}-0000000000", **spec)


def measured(stack: Stack, one: Job, value: float, *, is_new: bool = True) -> Attempt:
    """A job that runs and has reported this return."""
    attempt = Attempt(stack, one, is_new=is_new)
    progress = Progress(step=500, total=1000, metrics={METRIC: value})
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="p")
    return attempt


def names(page: Page) -> Locator:
    return page.locator(".job .name > a")


@pytest.fixture
def three(stack: Stack) -> list[Attempt]:
    """Three jobs that run, of which the second has the best return."""
    values = {"low": 1.0, "high": 9.0, "middle": 5.0}
    return [
        measured(stack, numbered(number, name=name, labels={"arm": name[0]}), value)
        for number, (name, value) in enumerate(values.items())
    ]


@pytest.fixture
def sweep(stack: Stack) -> str:
    """The name of a sweep whose two trials run."""
    document = {
        "name": "seeds",
        "job": {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 1000}, "video": None},
        "method": "grid",
        "parameters": {"seed": [1, 2]},
    }
    answer = stack.http.post("/sweeps", json=document)
    SweepController(stack.store, stack.queue, stack.objects).run_once()
    for trial in stack.http.get(answer.headers["location"]).json()["trials"]:
        measured(stack, stack.store.get(trial["job"]), 3.0 + trial["number"], is_new=False)
    return "seeds"


@pytest.mark.usefixtures("three")
def test_a_click_on_a_columns_name_sorts_by_it_and_the_address_says_so(tab: Tab) -> None:
    page = tab.open()
    expect(names(page)).to_have_text(["middle", "high", "low"])
    header = page.get_by_role("columnheader", name="Return")
    header.get_by_role("button").click()
    expect(names(page)).to_have_text(["high", "middle", "low"])
    expect(header).to_have_attribute("aria-sort", "descending")
    assert re.search(r"sort=return&order=desc", page.url)
    page.reload()
    expect(names(page)).to_have_text(["high", "middle", "low"])
    header.get_by_role("button").press("Enter")
    expect(names(page)).to_have_text(["low", "middle", "high"])
    header.get_by_role("button").press("Enter")
    expect(names(page)).to_have_text(["middle", "high", "low"])
    expect(header).not_to_have_attribute("aria-sort", re.compile("."))
    # A narrow window has no header.
    page.set_viewport_size({"width": 380, "height": 900})
    page.get_by_label("Order").select_option("Name")
    expect(names(page)).to_have_text(["high", "low", "middle"])
    page.get_by_role("button", name="The other way round").click()
    expect(names(page)).to_have_text(["middle", "low", "high"])


@pytest.mark.usefixtures("three")
def test_a_sorted_table_says_that_older_jobs_are_left_out(tab: Tab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("core.adapters.postgres.sorting._MOST", 2)
    page = tab.open()
    expect(names(page)).to_have_text(["middle", "high", "low"])
    note = page.get_by_text("Sorted are the newest 2 jobs; older ones are in the table newest first.")
    expect(note).to_have_count(0)
    page.get_by_role("columnheader", name="Return").get_by_role("button").click()
    expect(names(page)).to_have_text(["high", "middle"])
    expect(note).to_be_visible()


@pytest.mark.usefixtures("three")
def test_the_browser_keeps_which_columns_are_shown(tab: Tab) -> None:
    page = tab.open()
    expect(page.get_by_role("columnheader", name="Device")).to_have_count(0)
    page.get_by_text("Columns", exact=True).click()
    page.get_by_role("checkbox", name="Device").check()
    page.get_by_role("checkbox", name="label arm").check()
    page.get_by_role("checkbox", name="Steps/s").uncheck()
    page.reload()
    expect(page.get_by_role("columnheader", name="Device")).to_be_visible()
    expect(page.get_by_role("columnheader", name="Steps/s")).to_have_count(0)
    page.get_by_role("button", name="arm", exact=True).click()
    expect(names(page)).to_have_text(["high", "low", "middle"])
    page.get_by_text("Columns", exact=True).click()
    page.get_by_role("button", name="Default columns").click()
    expect(page.get_by_role("columnheader", name="Steps/s")).to_be_visible()
    expect(page.get_by_role("columnheader", name="Device")).to_have_count(0)


@pytest.mark.usefixtures("three")
def test_a_sweep_is_a_row_that_opens_to_its_trials(tab: Tab, sweep: str) -> None:
    page = tab.open()
    expect(names(page)).to_have_text([sweep, "middle", "high", "low"])
    row = page.locator("tr.sweep")
    expect(row).to_contain_text("2 running")
    expect(row).to_contain_text("0 of 2 trials")
    page.get_by_role("button", name=f"Trials of {sweep}").click()
    expect(page.locator("tr.trial .name")).to_have_text([re.compile("trial 1"), re.compile("trial 0")])
    expect(page.locator("tr.trial .label")).to_have_count(0)
    page.get_by_role("button", name="Return").click()
    # It stands where its best trial does, which has 4; and its trials have the table's order.
    expect(names(page)).to_have_text(["high", "middle", sweep, "ant, train", "ant, train", "low"])
    page.get_by_label("Fold sweeps").uncheck()
    expect(page.locator("tr.job")).to_have_count(5)
    expect(page.locator("tr.sweep")).to_have_count(0)


def test_chosen_jobs_are_cancelled_and_deleted_after_a_word_about_it(
    stack: Stack, tab: Tab, three: list[Attempt]
) -> None:
    three[0].end()
    stack.store.add(numbered(9, name="waits"))
    page = tab.open()
    page.get_by_label("Choose all jobs of this page").check()
    expect(page.get_by_text("4 chosen")).to_be_visible()
    page.get_by_role("button", name="Cancel…").click()
    dialog = page.get_by_role("dialog", name="Cancel 3 jobs?")
    expect(dialog).to_contain_text("1 job waits and will never start.")
    expect(dialog).to_contain_text("2 jobs run: each saves its checkpoint")
    expect(dialog).to_contain_text("1 job has ended and stays as it is.")
    assert flaws(page) == []
    dialog.get_by_role("button", name="Leave them").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Cancel…").click()
    page.get_by_role("button", name="Cancel 3 jobs").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.locator(".status", has_text="cancelling")).to_have_count(2)
    # What was not cancelled is chosen still.
    expect(page.get_by_text("1 chosen")).to_be_visible()
    page.get_by_label("Choose waits").check()
    page.get_by_role("button", name="Delete…").click()
    page.get_by_role("button", name="Delete 2 jobs").click()
    expect(page.locator("tr.job")).to_have_count(2)
    expect(page.get_by_text("chosen")).to_have_count(0)


def test_a_job_that_cannot_be_deleted_says_why(stack: Stack, tab: Tab, three: list[Attempt]) -> None:
    three[0].keep("1.ckpt", b"x", role="checkpoint", step=1)
    three[0].end(JobStatus.SUCCEEDED)
    stack.store.add(numbered(9, name="goes on", resume_from={"job": three[0].id, "step": 1}))
    page = tab.open()
    page.get_by_label("Choose low").check()
    page.get_by_role("button", name="Delete…").click()
    page.get_by_role("button", name="Delete 1 job").click()
    dialog = page.get_by_role("dialog", name="0 jobs deleted")
    expect(dialog.get_by_role("listitem")).to_contain_text("low")
    expect(dialog.get_by_role("listitem")).to_contain_text(f"{9:012x}-0000000000")
    dialog.get_by_role("button", name="Close").click()
    expect(names(page)).to_have_count(4)


@pytest.mark.usefixtures("three")
def test_the_table_is_for_everybody(tab: Tab, sweep: str) -> None:
    page = tab.open()
    page.get_by_role("button", name=f"Trials of {sweep}").click()
    page.get_by_role("button", name="Return").click()
    page.get_by_label("Choose low").check()
    expect(page.locator("tr.trial .name")).to_have_count(2)
    page.get_by_text("Columns", exact=True).click()
    assert flaws(page) == []
