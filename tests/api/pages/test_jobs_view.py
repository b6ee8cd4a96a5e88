"""The list of jobs."""

import re

import pytest
from playwright.sync_api import Locator, Page, expect

from core.jobs.job import Job, Origin, Progress
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.pages.conftest import MakeTab, Tab


def numbered(number: int, **spec: object) -> Job:
    return job(f"{number:012x}-0000000000", **spec)


def names(page: Page) -> list[str]:
    return page.locator(".job .name > a").all_inner_texts()


def row_of(page: Page, text: str) -> Locator:
    return page.get_by_role("row").filter(has_text=text)


@pytest.mark.extra
def test_nothing_yet_says_what_to_do(tab: Tab) -> None:
    page = tab.open()
    expect(page.get_by_text("No jobs yet.")).to_be_visible()
    expect(page.get_by_text("gaitway submit ant", exact=True)).to_be_visible()
    page.get_by_role("link", name="Submit the first one").click()
    expect(page.get_by_role("heading", name="Submit a job")).to_be_visible()


def test_a_running_job_shows_its_progress_its_return_and_what_comes(stack: Stack, tab: Tab) -> None:
    attempt = Attempt(stack, job(name="first steps", labels={"project": "gaits"}))
    page = tab.open()
    row = row_of(page, "first steps")
    expect(row.locator(".status")).to_have_text("running")
    # 9.3: none was sent.
    expect(row).not_to_contain_text("seed")
    for step in (100, 200, 300):
        attempt.say("metrics", step=step, values={"eval/episode_reward": step / 10})
    progress = Progress(
        step=300, total=1000, steps_per_second=100.0, eta_s=7.0, metrics={"eval/episode_reward": 30.0}
    )
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="p")
    expect(row.locator(".of-steps")).to_have_text("300 of 1K · 7 s left")
    expect(row.locator(".of-speed")).to_have_text("100")
    expect(row.locator(".of-return")).to_have_text("30")
    expect(row.get_by_role("img", name="Return, from 10 to 30")).to_be_visible()
    drawing = progress.model_copy(update={"step": 1000, "phase": "drawing"})
    stack.store.record(attempt.id, attempt.claim.token, "events", [], drawing, write_id="q")
    expect(row).to_contain_text("1K of 1K · draws the video…")
    attempt.end()
    expect(row.locator(".status")).to_have_text("succeeded")


@pytest.mark.extra
def test_a_name_with_markup_is_text(stack: Stack, tab: Tab) -> None:
    stack.store.add(numbered(1, name="<img src=x onerror=alert(1)><b>bold</b>"))
    page = tab.open()
    expect(page.locator(".job .name > a")).to_have_text("<img src=x onerror=alert(1)><b>bold</b>")


def test_filters_stand_in_the_address_and_come_back_with_it(stack: Stack, tab: Tab) -> None:
    stack.store.add(numbered(1, name="a walk", labels={"project": "gaits"}))
    stack.store.add(numbered(2, name="a run", labels={"project": "gaits", "seed": "2"}))
    stack.store.add(numbered(3, name="a swim"))
    page = tab.open()
    page.get_by_role("link", name="project: gaits").first.click()
    expect(page.locator(".job")).to_have_count(2)
    page.get_by_label("Search").fill("RUN")
    expect(page.locator(".job")).to_have_count(1)
    assert re.search(r"#/jobs\?.*label=project%3Agaits", page.url)
    assert "search=RUN" in page.url
    page.reload()
    expect(page.locator(".job")).to_have_count(1)
    assert names(page) == ["a run"]
    page.get_by_role("combobox", name="Status").select_option("failed")
    expect(page.get_by_text("No job matches these filters.")).to_be_visible()
    page.go_back()
    expect(page.locator(".job")).to_have_count(1)
    page.get_by_role("button", name="Remove the filter project:gaits").click()
    expect(page.locator(".job")).to_have_count(1)


@pytest.mark.extra
def test_a_label_without_a_colon_says_so(stack: Stack, tab: Tab) -> None:
    """9.3: it filtered nothing, silently."""
    stack.store.add(numbered(1, name="a walk", labels={"project": "gaits"}))
    page = tab.open()
    label = page.get_by_label("Label", exact=True)
    label.fill("project")
    label.press("Enter")
    expect(page.get_by_role("alert")).to_contain_text("“project” has no colon after a key")
    expect(label).to_have_value("project")
    assert tab.violations() == []
    label.fill("project:gaits")
    label.press("Enter")
    expect(page.get_by_role("button", name="Remove the filter project:gaits")).to_be_visible()
    expect(page.get_by_role("alert")).to_have_count(0)
    # By hand in the address; backticks of the service's sentences are code.
    page = tab.open("#/jobs?label=project")
    expect(page.get_by_role("alert")).to_contain_text("label must be key:value")
    expect(page.get_by_role("alert").locator("code").first).to_have_text("label")


@pytest.mark.extra
def test_an_imported_trial_does_not_look_like_a_trial_of_a_sweep_here(stack: Stack, tab: Tab) -> None:
    """9.3."""
    labels = {"sweep": "019aa3c2f0b1-0000000000", "trial": "3", "project": "gaits"}
    origin = Origin(job="019aa3c2f0b1-5be0c1d2e3", version="1.0", imported_at=NOON)
    stack.store.add(numbered(1, name="theirs", labels=labels).model_copy(update={"imported_from": origin}))
    stack.store.add(numbered(2, name="ours", labels=labels))
    page = tab.open()
    theirs, ours = (row_of(page, name) for name in ("theirs", "ours"))
    expect(theirs.get_by_role("list", name="Labels")).to_have_text("project: gaits")
    expect(theirs).to_contain_text("imported")
    expect(ours.get_by_role("list", name="Labels")).to_contain_text("trial: 3")


@pytest.mark.extra
def test_an_export_becomes_a_job_that_says_where_it_was_run(stack: Stack, tab: Tab, exported: bytes) -> None:
    page = tab.open()
    page.get_by_text("Import an export").click()
    chooser = page.get_by_label("The zip that “Export” of a job gives")
    chooser.set_input_files({"name": "a.zip", "mimeType": "application/zip", "buffer": b"PK"})
    expect(page.get_by_role("alert")).to_contain_text("This is not a zip file")
    assert tab.violations() == []
    chooser.set_input_files({"name": "a.zip", "mimeType": "application/zip", "buffer": exported})
    expect(page.get_by_role("heading", name="first")).to_be_visible()
    origin = re.compile("imported .*: job 019aa3c2f0b1-5be0c1d2e3 of a service with Gaitway")
    expect(page.get_by_text(origin)).to_be_visible()
    expect(page.locator(".status").first).to_have_text("succeeded")


@pytest.mark.extra
def test_older_jobs_are_a_page_away(stack: Stack, tab: Tab) -> None:
    for number in range(30):
        stack.store.add(numbered(number, name=f"job {number}"))
    page = tab.open()
    expect(page.locator(".job")).to_have_count(25)
    page.get_by_role("link", name="Older jobs").click()
    expect(page.locator(".job")).to_have_count(5)
    assert names(page) == [f"job {number}" for number in (4, 3, 2, 1, 0)]
    page.get_by_role("link", name="Newest").click()
    expect(page.locator(".job")).to_have_count(25)


@pytest.mark.extra
def test_a_waiting_job_and_a_failed_one_say_why(stack: Stack, tab: Tab) -> None:
    stack.store.add(numbered(1, name="waits"))
    failed = Attempt(stack, numbered(2, name="fell"))
    failed.end(JobStatus.FAILED, Reason.DIVERGED)
    page = tab.open()
    expect(row_of(page, "waits")).to_contain_text("no worker is running")
    expect(row_of(page, "fell")).to_contain_text("It came to its end.")


@pytest.mark.extra
def test_the_list_can_be_walked_by_keyboard(stack: Stack, tab: Tab) -> None:
    stack.store.add(numbered(1, name="first steps"))
    page = tab.open()
    expect(page.locator(".job")).to_have_count(1)
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="To the content")).to_be_focused()
    page.keyboard.press("Enter")
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent") == "first steps":
            break
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="first steps")).to_be_visible()


@pytest.mark.extra
def test_workers_and_the_queue_say_what_waits_and_why(stack: Stack, make_tab: MakeTab) -> None:
    tab = make_tab()
    page = tab.open("#/workers")
    expect(page.get_by_text("No worker is running, so jobs wait.")).to_be_visible()
    from datetime import timedelta

    stack.store.announce(
        WorkerInfo(
            name="host:cpu",
            host="host",
            pid=1,
            device="cpu",
            queues=("gaitway-cpu-normal",),
            started_at=NOON,
            seen_at=NOON,
        ),
        timedelta(minutes=1),
    )
    stack.store.add(numbered(1, name="wants a GPU", resources={"accelerator": "gpu"}))
    row = page.get_by_role("row").filter(has_text="wants a GPU")
    expect(row).to_contain_text("No worker has exactly one GPU: the workers here have cpu.")
    expect(page.get_by_role("heading", name="host:cpu")).to_be_visible()
    waiting = page.get_by_role("region", name="By project").get_by_role("row").nth(1)
    expect(waiting.get_by_role("cell").nth(2)).to_have_text("1")
