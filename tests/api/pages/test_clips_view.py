"""Clips on the page: sent by the file input, listed with what a worker found, and looked at."""

from typing import Any

from playwright.sync_api import expect

from tests.api.conftest import Stack
from tests.api.pages.conftest import Tab, flaws
from tests.api.test_clips import DESCRIPTION, FILE, worker

CHOOSER = "Choose a file of clips"
SENT: Any = {"name": "walks.csv", "mimeType": "text/csv", "buffer": FILE}


def test_clips_are_sent_described_and_deleted(tab: Tab, stack: Stack) -> None:
    page = tab.open("#/clips")
    expect(page.get_by_text("No clips yet.")).to_be_visible()
    with worker(stack, status="ready", description=DESCRIPTION):
        page.get_by_label("Frames per second").fill("50")
        page.get_by_label(CHOOSER).set_input_files(SENT)
        expect(page.get_by_role("status").filter(has_text="walks.csv is there.")).to_be_visible()
    card = page.get_by_role("region", name="walks.csv")
    expect(card.get_by_text("2 clips (csv), 1 joints")).to_be_visible()
    expect(card.get_by_text("101 frames at 50/s, 2.0 s")).to_be_visible()
    expect(card.get_by_text("A foot slides.")).to_be_visible()
    assert flaws(page) == []
    card.get_by_role("button", name="Delete").click()
    card.get_by_role("button", name="Yes").click()
    expect(page.get_by_text("No clips yet.")).to_be_visible()


def test_refused_clips_say_why(tab: Tab, stack: Stack) -> None:
    page = tab.open("#/clips")
    with worker(stack, status="refused", message="The file gives no rate: send `rate`."):
        page.get_by_label(CHOOSER).set_input_files(SENT)
        expect(page.get_by_role("alert").filter(has_text="The file gives no rate")).to_be_visible()
