"""Models on the page: sent by the file input or by a drop, and what a worker found in them."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from core.environments.mjcf.archive import examine
from core.storage import keys
from tests.api.conftest import Stack
from tests.api.pages.conftest import Tab, flaws
from tests.api.test_models import DESCRIPTION, worker
from tests.models import identity
from tests.unit.environments.mjcf.probe import XML
from tests.unit.environments.mjcf.test_archive import zipped

CHOOSER = "Drop an MJCF or URDF file here"


@pytest.fixture
def reading(stack: Stack) -> Iterator[None]:
    """A worker that describes each model, and has a recipe for it."""
    recipe = {
        "recipe": {"feet": ["arm"], "edits": {"feet": ["arm"], "pose": {"keyframe": "raised"}}},
        "recipe_notes": ["It has no keyframe."],
        "recipe_engines": {"native": None, "compiled": None},
    }
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update=recipe)):
        yield


def expect_the_ball(page: Page) -> None:
    """The page describes the model: a ball of 1 kg, and an arm of 0.1 kg that a motor moves at its elbow."""
    expect(page.get_by_role("status").filter(has_text="ball.xml is there.")).to_be_visible()
    expect(page.get_by_role("heading", name="ball.xml", exact=True)).to_be_visible()
    expect(page.get_by_text(identity(XML), exact=True)).to_be_visible()
    facts = page.locator(".facts-list")
    expect(facts.locator("dt:text-is('Feet') + dd")).to_have_text("arm")
    expect(facts.locator("dt:text-is('Pose') + dd")).to_have_text("the keyframe raised")
    expect(facts.locator("dt:text-is('Engines') + dd")).to_have_text(
        "native, compiled, with the recipe's edits"
    )
    expect(facts.locator("dt:text-is('Mass') + dd")).to_have_text("1.1 kg")
    page.get_by_text("Engines, as it is: native, warp").click()
    expect(facts.locator("dt:text-is('mjx') + dd")).to_have_text(
        "does not run it as it is: Ellipsoids and boxes are not implemented."
    )
    expect(facts.locator("dt:text-is('native') + dd")).to_have_text(
        "the same to 1e-7 after 1 s (its code took 2 s to make)"
    )
    expect(facts.locator("dt:text-is('Chosen') + dd")).to_have_text("native on a CPU, warp on a GPU")
    page.get_by_text("Parts: joints 2, actuators 1").click()
    expect(facts.locator("dt:text-is('Sizes') + dd")).to_contain_text("nq 8, nv 7, nu 1")
    expect(facts.locator("dt:text-is('actuators') + dd")).to_have_text("elbow [-0.5, 1.5]")
    page.get_by_text("A job in which it learns to walk by command").click()
    expect(page.get_by_text("It has no keyframe.")).to_be_visible()
    expect(page.get_by_role("region", name="The job as JSON")).to_contain_text('"feet": [')
    expect(page.get_by_role("link", name="Let it walk by command")).to_have_attribute(
        "href", re.compile("^#/submit.job=.*%22feet%22")
    )
    expect(page.get_by_role("link", name="Train it on terms of your own")).to_be_visible()


@pytest.mark.usefixtures("reading")
def test_a_model_is_sent_by_the_file_input_and_described(tab: Tab) -> None:
    page = tab.open("#/models")
    file = {"name": "ball.xml", "mimeType": "text/xml", "buffer": XML}
    page.get_by_label(CHOOSER).set_input_files(file)  # pyright: ignore
    expect_the_ball(page)
    tab.picture("models-described")
    assert flaws(page) == []
    tab.picture("models-narrow")


@pytest.mark.extra
@pytest.mark.usefixtures("reading")
def test_a_model_is_sent_by_a_drop_and_described(tab: Tab) -> None:
    page = tab.open("#/models")
    target = page.get_by_role("region", name="Upload a model")
    dragged = page.evaluate_handle(
        """text => {
            const dragged = new DataTransfer();
            dragged.items.add(new File([text], "ball.xml", { type: "text/xml" }));
            return dragged;
        }""",
        XML.decode(),
    )
    target.dispatch_event("dragover", {"dataTransfer": dragged})
    expect(target).to_have_class("drop over")
    target.dispatch_event("drop", {"dataTransfer": dragged})
    expect(target).not_to_have_class("drop over")
    expect_the_ball(page)


@pytest.mark.extra
def test_a_model_that_no_worker_reads_yet_says_what_it_waits_for(tab: Tab) -> None:
    page = tab.open("#/models")
    file = {"name": "ball.xml", "mimeType": "text/xml", "buffer": XML}
    page.get_by_label(CHOOSER).set_input_files(file)  # pyright: ignore
    said = "ball.xml waits for a worker to read it; a busy one does so after its job."
    expect(page.get_by_role("status").filter(has_text=said)).to_be_visible()


@pytest.mark.extra
def test_the_document_of_a_zip_that_is_the_model_can_be_named(stack: Stack, tab: Tab) -> None:
    page = tab.open("#/models")
    file = {"name": "two.zip", "mimeType": "application/zip", "buffer": zipped({"a.xml": XML, "b.xml": XML})}
    with worker(stack, status="refused", message="The zip has 2 documents that no other includes."):
        page.get_by_label(CHOOSER).set_input_files(file)  # pyright: ignore
        expect(page.get_by_role("alert")).to_contain_text("2 documents")
    page.get_by_label("the one that is the model").fill("b.xml")
    described = DESCRIPTION.model_copy(update={"main": "b.xml"})
    with worker(stack, status="ready", description=described):
        page.get_by_role("button", name="Send two.zip again").click()
        expect(page.get_by_role("status")).to_have_text("two.zip is there, read from b.xml.")
    expect(page.locator(".card").get_by_text("read from b.xml")).to_be_visible()
    (model,) = stack.store.models.all()
    assert examine(stack.objects.get(keys.model_source(model.id))).main == "b.xml"
    assert tab.violations() == []


@pytest.mark.extra
@pytest.mark.usefixtures("reading")
def test_the_form_offers_the_models_that_were_sent(tab: Tab) -> None:
    page = tab.open("#/submit")
    page.locator("#environment").select_option("mjcf")
    page.get_by_role("link", name="send one").click()
    file = {"name": "ball.xml", "mimeType": "text/xml", "buffer": XML}
    page.get_by_label(CHOOSER).set_input_files(file)  # pyright: ignore
    expect_the_ball(page)
    tab.open("#/submit")
    page.locator("#environment").select_option("mjcf")
    page.get_by_label("Model", exact=True).select_option(index=1)
    expect(page.get_by_role("complementary", name="Preview")).to_contain_text(identity(XML))
    assert tab.violations() == []
    tab.picture("submit-own-model")


@pytest.mark.extra
def test_a_model_that_is_no_model_is_refused_with_the_services_words(tab: Tab) -> None:
    page = tab.open("#/models")
    expect(page.get_by_text("No models yet.")).to_be_visible()
    page.get_by_label(CHOOSER).set_input_files(
        {"name": "robot.zip", "mimeType": "application/zip", "buffer": b"<mujoco/>"}
    )
    expect(page.get_by_role("alert")).to_contain_text("not a zip")
