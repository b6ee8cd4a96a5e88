"""The page without a mouse: Tab reaches all that can be used, and shows where it is."""

import pytest
from playwright.sync_api import Page, expect

from tests.api.conftest import Attempt, Stack, job
from tests.api.pages.conftest import Tab

# Each visible control gets a number. Of a group of radio buttons only the chosen one does: arrow keys reach
# the others.
_NUMBERED = """() => {
  const able = "a[href], button, input, select, textarea, summary, video[controls], [tabindex='0']";
  const isOther = (one) => one.type === "radio" && !one.checked;
  const isShown = (one) => !one.disabled && !isOther(one) && one.checkVisibility();
  const shown = [...document.querySelectorAll(able)].filter(isShown);
  shown.forEach((one, number) => (one.dataset.number = number));
  return shown.map((one) => one.outerHTML.slice(0, 100));
}"""
# The number of the control that has the focus, and whether an outline shows it.
_FOCUSED = """() => {
  const { outlineStyle, outlineWidth } = getComputedStyle(document.activeElement);
  const { number } = document.activeElement.dataset;
  const isSeen = outlineStyle !== "none" && parseFloat(outlineWidth) > 0;
  return [number === undefined ? -1 : Number(number), isSeen];
}"""


@pytest.fixture
def pair(stack: Stack) -> list[Attempt]:
    found = [
        Attempt(stack, job(f"{seed:012x}-0000000000", name=f"seed {seed}", seed=seed)) for seed in (1, 2)
    ]
    for attempt in found:
        for step in (100, 200):
            attempt.say("metrics", step=step, values={"eval/episode_reward": float(step)})
    return found


_FORMS = ("#/submit", "#/sweeps/new")


@pytest.mark.extra
@pytest.mark.parametrize("view", ["#/jobs/{0}", "#/compare?ids={0},{1}", *_FORMS])
def test_tab_reaches_all_that_can_be_used(tab: Tab, pair: list[Attempt], view: str) -> None:
    page = tab.open(view.format(*(attempt.id for attempt in pair)))
    expect(page.locator("main h1")).to_be_visible()
    expect(page.get_by_text("Loading")).to_have_count(0)
    if view in _FORMS:  # They are drawn again when what they ask for comes; the other views stream for ever.
        page.wait_for_load_state("networkidle")
    there = page.evaluate(_NUMBERED)
    reached, unseen = walk(page, len(there))
    assert [there[number] for number in range(len(there)) if number not in reached] == []
    assert [there[number] for number in sorted(unseen)] == []


def walk(page: Page, number: int) -> tuple[set[int], set[int]]:
    """The elements that Tab reaches, and those of them that do not show that they have the focus."""
    reached, unseen = set[int](), set[int]()
    for _ in range(2 * number):  # A control of the browser's own may have several places.
        page.keyboard.press("Tab")
        place, is_seen = page.evaluate(_FOCUSED)
        if place >= 0:
            reached.add(place)
            if not is_seen:
                unseen.add(place)
        elif reached:
            break
    return reached, unseen


def test_a_job_is_sent_from_the_form_by_keys_alone(tab: Tab) -> None:
    page = tab.open("#/submit")
    name = page.get_by_label("name", exact=True)
    expect(name).to_be_visible()
    name.focus()
    page.keyboard.type("by hand")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="by hand")).to_be_visible()
