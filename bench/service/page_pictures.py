"""Takes the documentation's pictures of the page: `python -m bench.service.page_pictures docs/pictures`.

It trains two ants and a pendulum on this machine, for some minutes, and looks at them in Chromium. Look at
every picture before you commit it.
"""

import argparse
import io
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Browser, Page

from bench.stack.browser import stack_and_browser
from gaitway.client import Client

_EXAMPLES = Path(__file__).parents[2] / "examples"
_VIDEO = {"every_checkpoint": True, "seconds": 8, "width": 640, "height": 360}
_ANT: dict[str, Any] = {
    "environment": "ant",
    "checkpoints": {"every_steps": 300_000},
    "video": _VIDEO,
    "labels": {"project": "gaits"},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--timesteps", type=int, default=1_200_000, help="of each ant")
    arguments = parser.parse_args()
    with stack_and_browser(workers=1) as (parts, browser), Client(parts.url) as client:
        _take(browser, client, parts.url, arguments.folder, arguments.timesteps)


def _take(browser: Browser, client: Client, url: str, folder: Path, timesteps: int) -> None:
    desk = browser.new_page(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    client.add_model(_EXAMPLES / "quadruped.xml")
    # A worker that trains would not draw the body.
    _show(desk, f"{url}/#/submit?environment=ant")
    desk.get_by_role("img", name="ant, camera track").wait_for(timeout=120_000)
    _keep(desk, folder / "page-submit.webp")
    trained = [
        client.submit(
            {
                **_ANT,
                "name": f"ant, learning rate {rate:g}",
                "algorithm": {"num_timesteps": timesteps, "learning_rate": rate},
            }
        )
        for rate in (3e-4, 1e-3)
    ]
    for job in trained:
        client.wait(job.id)
    pendulum = client.submit({"environment": "inverted_pendulum", "name": "pendulum", "video": _VIDEO})
    client.wait(pendulum.id)
    running_job = client.submit({**_ANT, "name": "a longer run", "algorithm": {"num_timesteps": 10**7}})
    waiting = client.submit({"environment": "hopper", "name": "hopper, waits for the worker"})
    for event in client.events(running_job.id):
        if event.kind == "artifact" and event.data["role"] == "checkpoint":
            break
    ids = ",".join(job.id for job in trained)
    views = {
        "page": "#/jobs",
        "page-job": f"#/jobs/{trained[1].id}",
        "page-compare": f"#/compare?ids={ids}",
        "page-models": "#/models",
        "page-workers": "#/workers",
    }
    for name, view in views.items():
        _show(desk, f"{url}/{view}")
        _keep(desk, folder / f"{name}.webp")
    phone = browser.new_page(
        viewport={"width": 380, "height": 820},
        reduced_motion="reduce",
        color_scheme="dark",
        device_scale_factor=2,
    )
    _show(phone, f"{url}/#/jobs/{trained[1].id}")
    _keep(phone, folder / "page-phone.webp", most=2)
    for job in (waiting, running_job):
        client.cancel(job.id)


def _show(page: Page, address: str) -> None:
    """Until nothing is loaded any more and each film shows its first picture."""
    page.goto("about:blank")
    page.goto(address)
    page.locator("main h1").wait_for()
    page.wait_for_function("() => !document.querySelector('main').innerText.includes('Loading')")
    page.wait_for_function(
        "() => [...document.querySelectorAll('video')].every((one) => one.readyState >= 2)"
    )
    page.wait_for_timeout(4000)  # Streams stay open: that the last curve is drawn shows in nothing.


def _keep(page: Page, path: Path, most: float = 1.2) -> None:
    """most: what is lower than this many times the width is cut off."""
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True)))
    height = min(picture.height, round(most * picture.width))
    picture.crop((0, 0, picture.width, height)).save(path, quality=80, method=6)


if __name__ == "__main__":
    main()
