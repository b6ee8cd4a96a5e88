"""A Chromium for benches and pictures of the page."""

import shutil
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from bench.stack.processes import Parts, running

_FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]


@contextmanager
def chromium(*flags: str) -> Generator[Browser]:
    """A Chromium without a window. Raises RuntimeError where there is none."""
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        raise RuntimeError("There is no Chromium; on Debian: apt-get install chromium fonts-dejavu-core")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*_FLAGS, *flags])
        yield browser
        browser.close()


@contextmanager
def stack_and_browser(workers: int = 0) -> Generator[tuple[Parts, Browser]]:
    """The embedded stack, in a folder that goes afterwards, and a Chromium that draws in software."""
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running(Path(folder, "stack"), workers=workers) as parts,
        chromium("--enable-unsafe-swiftshader") as browser,
    ):
        yield parts, browser
