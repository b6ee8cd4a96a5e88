"""The view of webhooks, and what a job's page says of who was told."""

from collections.abc import Iterator

import pytest
from fastapi import FastAPI
from playwright.sync_api import Locator, expect

from core.news.webhook import Outcome
from tests.api.accounts import Lab, opened
from tests.api.conftest import Stack
from tests.api.pages.conftest import Tab, flaws
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
    (due,) = stack.store.claim_deliveries(1, is_http=True)
    stack.store.note_outcome(due, Outcome(answer=204))
    expect(sent).to_contain_text("delivered (204)")
    sent.get_by_role("button", name="Send").click()
    expect(sent).to_have_count(2)
    expect(sent.first).to_contain_text("waiting: not tried yet.")
    tab.picture("news-added")
    page.get_by_role("button", name="Change lab-chat").click()
    form = page.get_by_role("form", name="Change lab-chat")
    expect(form.get_by_role("heading")).to_be_focused()
    form.get_by_label("Address").fill("http://10.1.2.3/hook")
    form.get_by_role("button", name="Change it").click()
    expect(page.get_by_role("alert")).to_contain_text("which is not public")
    form.get_by_role("button", name="Stop it").click()
    expect(row).to_contain_text("Stopped by hand.")
    expect(sent.first).to_contain_text("failed: Stopped by hand.")
    form.get_by_role("button", name="Start it").click()
    expect(row).not_to_contain_text("Stopped by hand.")
    form.get_by_role("button", name="Make a new secret").click()
    form.get_by_role("button", name="Yes, make a new secret").click()
    expect(page.get_by_role("region", name="The secret")).to_contain_text("whsec_")
    tab.picture("news-change-1280")
    assert flaws(page) == []
    tab.picture("news-change-380")
    form.get_by_label("Address").fill("https://1.0.0.1")
    form.get_by_label("a job has started").uncheck()
    form.get_by_role("button", name="Change it").click()
    expect(row).to_contain_text("https://1.0.0.1")
    expect(row).not_to_contain_text("job.started")
    expect(page.get_by_role("form", name="Add a webhook")).to_be_visible()
    row.get_by_role("button", name="Delete").click()
    row.get_by_role("button", name="Yes, delete").click()
    expect(page.get_by_text("Nobody is told of the jobs of default yet.")).to_be_visible()


@pytest.mark.parametrize("view", ["submit", "sweeps/new"])
def test_a_form_offers_a_projects_webhooks(stack: Stack, tab: Tab, view: str) -> None:
    def form() -> Locator:
        page = tab.open("")
        page = tab.open(f"#/{view}")
        if view != "submit":
            page.get_by_text("Environment, algorithm and other settings of the job").click()
        return page.locator("form")

    expect(form()).to_contain_text("The project default has no webhooks; News adds them.")
    for name in ("lab_chat", "phone"):
        document = {"name": name, "url": "https://1.1.1.1/hook"}
        assert stack.http.post("/projects/default/webhooks", json=document).status_code == 201
    ticks = form().get_by_role("group", name="notify")
    expect(ticks.get_by_label("lab_chat")).not_to_be_checked()
    ticks.get_by_label("phone", exact=True).check()
    code = tab.page.get_by_role("region", name="The submission as JSON")
    expect(code).to_contain_text('"phone"')
    tab.picture(f"{view.replace('/', '-')}-notify")
    ticks.get_by_label("phone", exact=True).uncheck()
    expect(code).not_to_contain_text("notify")


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
    for name in ("Test lab-chat", "Change lab-chat"):
        expect(page.get_by_role("button", name=name)).to_have_count(0)
