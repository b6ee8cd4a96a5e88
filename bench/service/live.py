"""Measures how soon a running training's newest checkpoint moves on its page, as a replay and pushed."""

from typing import Any

from playwright.sync_api import Browser

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result
from bench.measure.statistics import spread
from bench.stack.browser import stack_and_browser
from gaitway.client import Client

# It outlasts the measurement; on two cores a checkpoint comes every few seconds.
_JOB: dict[str, Any] = {
    "environment": "ant",
    "algorithm": {"num_timesteps": 10**9, "num_evals": 2},
    "checkpoints": {"every_steps": 100_000},
}
# Notes when the page first drew the episode of each step, or first said whose policy acts; in ms since 1970.
_WATCH = """() => {
  window.seen = {};
  const look = () => {
    const canvas = document.querySelector("canvas[data-pictures]");
    const said = canvas && `${canvas.getAttribute("aria-label")} ${document.querySelector("main").innerText}`;
    const step = said?.match(/(?:episode 1 at step|Policy at step) ([\\d,]+)/)?.[1];
    if (step) window.seen[step.replaceAll(",", "")] ??= Date.now();
    requestAnimationFrame(look);
  };
  look();
}"""


def measure(options: Options) -> Result:
    """Watch a real worker's training in Chromium on the same machine until enough checkpoints have come."""
    count = 2 if options.quick else 8
    with stack_and_browser(workers=1) as (parts, browser), Client(parts.url) as client:
        job = client.submit(_JOB)
        delays = {
            view: _delays(browser, client, f"{parts.url}/#/jobs/{job.id}/{view}", job.id, count)
            for view in ("replay", "push")
        }
        client.cancel(job.id)
    return Result(
        name="live",
        title="A training's newest policy on its page",
        command="./run bench live",
        quick=options.quick,
        machine=this_machine(),
        figures=[
            Figure.of("from a checkpoint to the picture of its replay", spread(delays["replay"]), "s"),
            Figure.of("from a checkpoint to its policy in the pushed body", spread(delays["push"]), "s"),
        ],
        rows=[{"view": view, "seconds": value} for view, values in delays.items() for value in values],
        notes=[
            "An ant trains with PPO on all cores, beside the service and Chromium, which draws in software. "
            "Counted from the moment at which the supervisor hears that the checkpoint is written, "
            "over those checkpoints that the page showed: some have no replay, since replays take at most "
            "3 % of the time."
        ],
    )


def _delays(browser: Browser, client: Client, address: str, job_id: str, count: int) -> list[float]:
    """Seconds from checkpoints of this running job until the view shows them."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(300_000)
    page.goto(address)
    page.locator("canvas[data-pictures]").wait_for()
    page.evaluate(_WATCH)
    # The first that it knows was there before.
    page.wait_for_function("count => Object.keys(window.seen).length > count", arg=count)
    seen: dict[str, float] = page.evaluate("window.seen")
    page.context.close()
    steps = {int(step): at / 1000 for step, at in seen.items()}
    del steps[min(steps)]
    delays = list[float]()
    for event in client.events(job_id):
        is_checkpoint = event.kind == "artifact" and event.data["role"] == "checkpoint"
        if event.time and is_checkpoint and event.data["step"] in steps:
            delays.append(steps[event.data["step"]] - event.time.timestamp())
        if len(delays) == len(steps):
            break
    return delays
