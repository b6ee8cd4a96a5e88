"""A real Chromium that looks at the real service; what it complains about fails the test."""

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, Route, expect, sync_playwright

from tests.api.conftest import Stack

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL in software
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
_AXE = (Path(__file__).parent / "vendor" / "axe.js").read_text()
# Pictures of the page, for people, where this names a folder.
_PICTURES = os.environ.get("GAITWAY_PICTURES")


def _chromium() -> str:
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        sentence = "There is no Chromium; on Debian: apt-get install chromium fonts-dejavu-core"
        if os.environ.get("CI") == "true":
            pytest.fail(sentence)
        pytest.skip(sentence)
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Ended with the module: Playwright's event loop runs in this thread, which others' tests need."""
    expect.set_options(timeout=20_000)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_chromium(), args=_FLAGS)
        yield browser
        browser.close()


def violations(page: Page, options: str = "") -> list[str]:
    """Axe's findings, each with the elements. options: more of axe's, in JavaScript."""
    if page.evaluate("typeof axe") == "undefined":
        page.evaluate(_AXE)
    asked = f"axe.run(document, {{preload: false, resultTypes: ['violations'], {options}}})"
    found: dict[str, Any] = page.evaluate(asked)
    return [f"{rule['id']}: {[node['html'] for node in rule['nodes']]}" for rule in found["violations"]]


def overflow(page: Page) -> int:
    """Pixels by which the page is wider than its window."""
    return page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")


def flaws(page: Page) -> list[str]:
    """Axe's findings, and the pixels by which the page is wider than its window. It is looked at 1280 and 380
    pixels wide, light and dark, and is left narrow and dark."""
    found: list[str] = []
    for width, colours in product((1280, 380), ("light", "dark")):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=colours)
        look = f"{width} pixels, {colours}"
        # Other colours change what these two rules find, and nothing else.
        options = "runOnly: ['color-contrast', 'link-in-text-block']" if colours == "dark" else ""
        found += [f"{look}: {violation}" for violation in violations(page, options)]
        if excess := overflow(page):
            found.append(f"{look}: {excess} pixels too wide")
    return found


@dataclass
class Tab:
    """A tab of the browser. complaints: errors of scripts, violations of the policy, requests elsewhere."""

    page: Page
    url: str
    complaints: list[str] = field(default_factory=list[str])

    def open(self, address: str = "") -> Page:
        """Show an address of the page, such as `#/jobs`."""
        self.page.goto(f"{self.url}/{address}")
        return self.page

    def violations(self) -> list[str]:
        return violations(self.page)

    def overflow(self) -> int:
        return overflow(self.page)

    def picture(self, name: str) -> None:
        if _PICTURES:
            self.page.screenshot(path=Path(_PICTURES) / f"{name}.png", full_page=True)


MakeTab = Callable[..., Tab]


@pytest.fixture
def make_tab(browser: Browser, stack: Stack) -> Iterator[MakeTab]:
    """Makes a tab of the given width and colours, which may reach nothing but the service."""
    tabs: list[Tab] = []

    def make(width: int = 1280, dark: bool = False, port: int = stack.port) -> Tab:
        context = browser.new_context(
            viewport={"width": width, "height": 900},
            color_scheme="dark" if dark else "light",
            reduced_motion="reduce",
            bypass_csp=False,
        )
        context.set_default_timeout(20_000)
        tab = Tab(context.new_page(), f"http://127.0.0.1:{port}")

        def only_ours(route: Route, request: Request) -> None:
            if urlsplit(request.url).hostname == "127.0.0.1":
                route.continue_()
            else:
                tab.complaints.append(f"asks {request.url}")
                route.abort()

        def hear(message: ConsoleMessage) -> None:
            # Neither a refusal that a test provokes is a complaint, nor that reading a picture takes time.
            expected = ("Failed to load resource", "GPU stall due to ReadPixels")
            if message.type in ("error", "warning") and not any(one in message.text for one in expected):
                tab.complaints.append(message.text)

        tab.page.route("**/*", only_ours)
        tab.page.on("console", hear)
        tab.page.on("pageerror", lambda error: tab.complaints.append(str(error)))
        tabs.append(tab)
        return tab

    yield make
    for tab in tabs:
        tab.page.context.close()
    assert [complaint for tab in tabs for complaint in tab.complaints] == []


@pytest.fixture
def tab(make_tab: MakeTab) -> Tab:
    return make_tab()
