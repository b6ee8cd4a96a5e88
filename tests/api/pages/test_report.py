"""A report as people get it: a file on their disk, opened without a service."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from core.jobs.status import JobStatus
from core.reasons import Reason
from core.rendering.mp4 import Mp4Writer
from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import Tab, flaws
from tests.api.pages.test_job_view import measure
from tests.api.pages.test_replay import drawn, keep, pictures
from tests.api.pages.test_replay import scene as scene

EVIL = '<img src=x onerror="document.title=1">'


@dataclass
class Reader:
    """A browser without a network. complaints: what it writes to its console, or asks for elsewhere."""

    page: Page
    folder: Path
    complaints: list[str] = field(default_factory=list[str])

    def open(self, stack: Stack, job_id: str) -> Page:
        """Save the report of the job, and open the file."""
        path = self.folder / f"{job_id}.html"
        path.write_bytes(stack.http.get(f"/jobs/{job_id}/report.html").content)
        self.page.goto(path.as_uri())
        if folder := os.environ.get("GAITWAY_PICTURES"):
            self.page.screenshot(
                path=Path(folder) / f"report-{len(list(self.folder.iterdir()))}.png", full_page=True
            )
        return self.page


@pytest.fixture
def reader(browser: Browser, tmp_path: Path) -> Iterator[Reader]:
    context = browser.new_context(offline=True, viewport={"width": 1000, "height": 800})
    reader = Reader(context.new_page(), tmp_path)
    # Reading a picture takes time without a GPU: no complaint.
    reader.page.on(
        "console",
        lambda message: None if "ReadPixels" in message.text else reader.complaints.append(message.text),
    )
    reader.page.on("pageerror", lambda error: reader.complaints.append(str(error)))
    reader.page.on(
        "request",
        lambda request: (
            None
            if request.url.startswith(("file:", "data:", "blob:"))
            else reader.complaints.append(request.url)
        ),
    )
    yield reader
    context.close()
    assert reader.complaints == []


def film(folder: Path) -> bytes:
    """Half a second, ever lighter."""
    path = folder / "film.mp4"
    with Mp4Writer(path, width=320, height=240, fps=10) as video:
        for number in range(5):
            video.write(np.full((240, 320, 3), 40 * number, np.uint8))
    return path.read_bytes()


def test_a_report_opens_from_a_disk_with_curve_video_settings_and_log(
    stack: Stack, reader: Reader, tmp_path: Path
) -> None:
    attempt = Attempt(stack, job(name="first steps", labels={"project": "vnl"}, seed=3))
    for step in range(0, 1000, 50):
        measure(stack, attempt, step, eval__episode_reward=step**0.5, training__loss=1 / (step + 1))
    attempt.print("compiled in 12 s")
    attempt.keep("video.mp4", film(tmp_path))
    attempt.end()
    page = reader.open(stack, attempt.id)
    expect(page.get_by_role("heading", name="first steps")).to_be_visible()
    # √950 = 30.82
    curve = page.get_by_role("img", name="Return. eval/episode_reward: last 30.82 at 950")
    expect(curve.locator("canvas")).to_be_visible()
    # 2: the present frame's data is there.
    page.wait_for_function("document.querySelector('video').readyState >= 2")
    assert page.evaluate("document.querySelector('video').videoWidth") == 320
    page.get_by_text("All ").first.click()
    expect(page.get_by_role("row", name="seed 3 sent")).to_be_visible()
    expect(page.get_by_role("row", name="priority normal filled in")).to_be_visible()
    page.get_by_text("1 other metrics").click()
    expect(page.get_by_role("img", name="training/loss").locator("canvas")).to_be_visible()
    expect(page.get_by_text("compiled in 12 s")).to_be_visible()
    expect(page.get_by_text("needs no network")).to_be_visible()
    assert flaws(page) == []


@pytest.mark.extra
@pytest.mark.parametrize("ended", [JobStatus.FAILED, None])
def test_a_job_that_runs_or_failed_and_has_no_video_has_a_report_where_markup_is_text(
    stack: Stack, reader: Reader, ended: JobStatus | None
) -> None:
    attempt = Attempt(stack, job(name=EVIL))
    attempt.print(EVIL)
    if ended:
        attempt.end(ended, Reason.DIVERGED)
    page = reader.open(stack, attempt.id)
    expect(page.get_by_role("heading", name=EVIL)).to_be_visible()
    expect(page).to_have_title(EVIL)
    said = "ended as failed without one" if ended else "There is none yet."
    expect(page.get_by_text(said)).to_be_visible()
    expect(page.get_by_text("Nothing was measured.")).to_be_visible()
    page.set_viewport_size({"width": 380, "height": 700})
    wider = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    assert page.evaluate(wider) == 0


@pytest.mark.extra
def test_a_report_replays_the_body_without_a_network(stack: Stack, reader: Reader, scene: bytes) -> None:
    attempt = Attempt(stack, job(name="rolls"))
    keep(attempt, scene, 100, num_episodes=2)
    attempt.end()
    page = drawn(reader.open(stack, attempt.id))
    count = pictures(page)
    page.wait_for_function("n => Number(document.querySelector('canvas').dataset.pictures) > n", arg=count)
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("slider", name="Moment").fill("0.5")
    expect(page.get_by_text("0.50 s of 1.00 s · return 10.0")).to_be_visible()
    page.get_by_label("Episode").select_option("All, side by side")
    expect(page.get_by_text("return 10.0, 10.0")).to_be_visible()
    page.get_by_label("Speed").select_option("2 ×")
    page.set_viewport_size({"width": 380, "height": 700})
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0


@pytest.mark.extra
def test_a_report_says_why_it_has_no_replay(
    stack: Stack, reader: Reader, scene: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempt = Attempt(stack, job())
    keep(attempt, scene, 100)
    [poses] = [file for file in stack.store.get(attempt.id).artifacts if file.role == "replay"]
    stack.objects.delete_prefix(poses.key)
    page = reader.open(stack, attempt.id)
    expect(page.get_by_text("The object store does not give it whole any more.")).to_be_visible()
    monkeypatch.setattr("api.sharing.report._MOST_REPLAY_BYTES", 1000)
    page = reader.open(stack, attempt.id)
    expect(page.get_by_text("It is larger than 1.0 kB")).to_be_visible()


@pytest.mark.extra
def test_the_page_of_a_job_shares_and_exports_it(stack: Stack, tab: Tab) -> None:
    attempt = Attempt(stack, job(name="first steps"))
    page = tab.open(f"#/jobs/{attempt.id}")
    with page.context.expect_page() as opening:
        page.get_by_role("link", name="Share").click()
    expect(opening.value.get_by_role("heading", name="first steps")).to_be_visible()
    with page.expect_download() as downloading:
        page.get_by_role("link", name="Export").click()
    assert downloading.value.suggested_filename == f"{attempt.id}.zip"
