"""The view of webhooks, and what a job's page says of who was told."""

from collections.abc import Iterator

import pytest
from fastapi import FastAPI
from playwright.sync_api import expect

from core.news.webhook import Outcome
from tests.api.accounts import Lab, opened
from tests.api.conftest import Stack
from tests.api.pages.conftest import Tab
from tests.api.pages.test_account import sign_in
from tests.contract.recording import cancelled, queued_job


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def test_a_webhook_is_added_tested_and_deleted(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/news")
    expect(page.get_by_text("Nobody is told of the jobs of default yet.")).to_be_visible()
    page.get_by_label("Name", exact=True).fill("lab-chat")
    page.get_by_label("Address").fill("http://10.1.2.3/hook")
    page.get_by_role("button", name="Add it").click()
    expect(page.get_by_role("alert")).to_contain_text("which is not public")
    page.get_by_label("Address").fill("https://1.1.1.1/hook")
    page.get_by_label("a job has started").check()
    page.get_by_role("button", name="Add it").click()
    expect(page.get_by_role("region", name="The secret")).to_contain_text("whsec_")
    row = page.get_by_role("region", name="Webhooks").get_by_role("row").filter(has_text="lab-chat")
    expect(row).to_contain_text("https://1.1.1.1/…")
    expect(row).to_contain_text("job.started")
    page.get_by_role("button", name="Test lab-chat").click()
    sent = page.get_by_role("region", name="Deliveries").get_by_role("row").filter(has_text="webhook.test")
    expect(sent).to_contain_text("waiting: not tried yet.")
    tab.picture("news-added")
    (due,) = stack.store.claim_deliveries(1, is_http=True)
    stack.store.note_outcome(due, Outcome(answer=204))
    expect(sent).to_contain_text("delivered (204)")
    row.get_by_role("button", name="Delete").click()
    row.get_by_role("button", name="Yes, delete").click()
    expect(page.get_by_text("Nobody is told of the jobs of default yet.")).to_be_visible()


def test_a_jobs_page_says_who_was_told(stack: Stack, tab: Tab) -> None:
    document = {"name": "lab-chat", "url": "https://1.1.1.1/hook"}
    assert stack.http.post("/projects/default/webhooks", json=document).status_code == 201
    job = stack.store.add(queued_job())
    stack.store.save(cancelled(job))
    stack.store.spread_news()
    (due,) = stack.store.claim_deliveries(1, is_http=True)
    stack.store.note_outcome(due, Outcome(error="It answered 500.", answer=500))
    page = tab.open(f"#/jobs/{job.id}")
    told = page.get_by_role("region", name="Deliveries").get_by_role("row").filter(has_text="lab-chat")
    expect(told).to_contain_text("waiting: It answered 500. Next try")
    tab.picture("news-of-a-job")


def test_a_viewer_adds_none_and_others_change_none(lab: Lab, tab: Tab) -> None:
    document = {"name": "lab-chat", "url": "https://1.1.1.1/hook"}
    assert lab.of("ann").post("/projects/a/webhooks", json=document).status_code == 201
    page = sign_in(tab, lab.token("vic").text, "#/news")
    expect(page.get_by_role("link", name="lab-chat")).to_be_visible()
    expect(page.get_by_role("form", name="Add a webhook")).to_have_count(0)
    expect(page.get_by_role("button", name="Test lab-chat")).to_have_count(0)
