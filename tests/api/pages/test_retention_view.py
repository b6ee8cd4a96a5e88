"""The part of the usage view that shows and sets what a project keeps."""

from collections.abc import Iterator

import pytest
from fastapi import FastAPI
from playwright.sync_api import expect

from core.jobs import removal
from tests.api.accounts import Lab, opened
from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import Tab, flaws
from tests.api.pages.test_account import sign_in
from tests.contract.recording import queued_job


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def ended(stack: Stack, job_id: str, name: str) -> Attempt:
    attempt = Attempt(stack, job(job_id, name=name))
    for step in (10, 20, 30):
        attempt.keep(f"checkpoint-{step}", b"c" * 1000, role="checkpoint", step=step)
    attempt.end()
    return attempt


def test_rules_are_shown_before_they_are_set(stack: Stack, tab: Tab) -> None:
    first = ended(stack, "019aa3c2f0b1-5be0c1d2e3", "walker")
    needed = ended(stack, "019aa3c2f0b2-5be0c1d2e3", "runner")
    waiting = stack.store.add(queued_job(resume_from={"job": needed.id, "step": 10}))
    page = tab.open("#/usage")
    kept = page.get_by_role("region", name="What is kept")
    expect(kept.get_by_text("default has no rules and keeps everything.")).to_be_visible()
    kept.get_by_label("Checkpoints kept of each job").fill("1")
    kept.get_by_role("button", name="Show what these rules remove").click()
    expect(kept).to_contain_text("2 jobs would lose 3 files, 3 kB.")
    expect(kept).to_contain_text(f"Something of runner stays: job {waiting.id} needs it.")
    assert flaws(page) == []
    tab.picture("retention-380")
    page.set_viewport_size({"width": 1280, "height": 900})
    tab.picture("retention-1280")
    kept.get_by_role("button", name="Set these rules").click()
    expect(kept.get_by_role("alert")).to_contain_text(f"job {needed.id} is needed by {waiting.id}")
    # Another number is shown first, again.
    kept.get_by_label("Checkpoints kept of each job").fill("3")
    kept.get_by_label("Videos, days").fill("30")
    kept.get_by_role("button", name="Show what these rules remove").click()
    expect(kept).to_contain_text("0 jobs would lose 0 files, 0 B.")
    kept.get_by_role("button", name="Set these rules").click()
    expect(kept).to_contain_text(
        "In default, of each job the newest 3 checkpoints stay; videos go after 30 days."
    )
    kept.get_by_role("button", name="Keep everything").click()
    kept.get_by_role("button", name="Yes, keep everything").click()
    expect(kept.get_by_text("default has no rules and keeps everything.")).to_be_visible()
    assert stack.http.post(f"/jobs/{waiting.id}/cancel").status_code == 200
    assert stack.http.put("/projects/default/retention", json={"checkpoints": 1}).status_code == 200
    list(removal.apply(store=stack.store, objects=stack.objects))
    page = tab.open(f"#/jobs/{first.id}/files")
    expect(page.get_by_text("retention rule checkpoints has removed 2 files of it, 2 kB")).to_be_visible()


def test_a_member_sees_rules_and_previews_alone(lab: Lab, tab: Tab) -> None:
    assert lab.of("root").put("/projects/a/retention", json={"videos_days": 30}).status_code == 200
    page = sign_in(tab, lab.token("vic").text, "#/usage")
    kept = page.get_by_role("region", name="What is kept")
    expect(kept).to_contain_text("In a, videos go after 30 days.")
    kept.get_by_role("button", name="Show what these rules remove").click()
    expect(kept).to_contain_text("0 jobs would lose 0 files")
    expect(kept.get_by_role("button", name="Set these rules")).to_have_count(0)
    expect(kept.get_by_role("button", name="Keep everything")).to_have_count(0)
