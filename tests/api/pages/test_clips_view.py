"""Clips on the page: sent by the file input, listed with what a worker found, and looked at."""

from hashlib import sha256
from typing import Any

from playwright.sync_api import expect

from core.clips.record import REPLAY, SCENE, MadeFile
from core.rendering.replay.replay import scene_of
from core.storage import keys
from tests.api.conftest import Stack
from tests.api.pages.conftest import Tab, flaws
from tests.api.pages.test_replay import MODEL, MOTION, drawn, replay
from tests.api.test_clips import DESCRIPTION, FILE, send, worker

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
    expect(card.get_by_text("how far from the body they are on average: knee 2.0 mm.")).to_be_visible()
    assert flaws(page) == []
    card.get_by_role("link", name="Train a policy to follow them").click()
    sent = page.get_by_role("region", name="The submission as JSON")
    expect(sent).to_contain_text('"task": "imitate"')
    expect(sent).to_contain_text('"battery": true')
    page.go_back()
    card.get_by_role("button", name="Delete").click()
    card.get_by_role("button", name="Yes").click()
    expect(page.get_by_text("No clips yet.")).to_be_visible()


def test_clips_that_no_worker_has_read_say_so(tab: Tab, stack: Stack) -> None:
    send(stack.http, name="walks")
    card = tab.open("#/clips").get_by_role("region", name="walks")
    expect(card.get_by_text("No worker has read it yet; a busy one does so after its job.")).to_be_visible()


def test_refused_clips_say_why(tab: Tab, stack: Stack) -> None:
    page = tab.open("#/clips")
    with worker(stack, status="refused", message="The file gives no rate: send `rate`."):
        page.get_by_label(CHOOSER).set_input_files(SENT)
        expect(page.get_by_role("alert").filter(has_text="The file gives no rate")).to_be_visible()


def test_each_clip_is_looked_at_as_a_replay(tab: Tab, stack: Stack) -> None:
    scene = scene_of(MODEL, MOTION.qpos[0], 2)
    content = {REPLAY: replay(2), SCENE: scene}
    made = {name: MadeFile(sha256=sha256(body).hexdigest(), size=len(body)) for name, body in content.items()}
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update={"made": made})):
        clips = send(stack.http, name="walks").json()["id"]
    for name, body in content.items():
        stack.objects.put(keys.made_of_clips(clips, name), body)
    page = tab.open("#/clips")
    page.get_by_role("button", name="Look at them").click()
    expect(page.get_by_role("img", name="Replay of walk")).to_be_visible()
    drawn(page)
    page.get_by_role("combobox", name="Clip", exact=True).select_option("turn")
    expect(page.get_by_role("img", name="Replay of turn")).to_be_visible()
    assert flaws(page) == []
