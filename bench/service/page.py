"""The page in a real Chromium on the same machine: first paint, a metric's way to it, the cost of readers.

Open pages are stood for by what they ask: a list every two seconds, and the events of one job that measures
once a second.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import timedelta
from typing import TYPE_CHECKING

import httpx

from bench.stack import Parts, chromium, running_parts, until
from bench.summary import Figure, middle, percentile
from core.adapters.wiring import job_store
from core.jobs.attempts import new_secret
from core.jobs.job import Job, Progress, new_job_id
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Entry, JobStore
from core.reasons import Reason

if TYPE_CHECKING:
    from playwright.sync_api import Browser

_LEASE = timedelta(seconds=50)  # At most four of the service's own.
_RETURN = "eval/episode_reward"
_BATCH = 1000
# The first paint in ms, and the bytes of all that came before the page was still.
_LOADED = """() => [
  performance.getEntriesByName("first-contentful-paint")[0].startTime,
  [...performance.getEntriesByType("resource"), ...performance.getEntriesByType("navigation")]
    .filter((one) => /^\\/(pages\\/.*)?$/.test(new URL(one.name).pathname))
    .reduce((sum, one) => sum + one.encodedBodySize, 0),
]"""
# Resolves with the moment at which a text stands in a curve's description.
_APPEARS = """(text) => new Promise((resolve) => {
  const look = () => document.querySelector(`[role=img][aria-label*="${text}"]`)
    ? resolve(Date.now()) : requestAnimationFrame(look);
  look();
})"""


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """On the embedded servers and one API process."""
    rows, readers, seconds = (3000, 5, 2) if arguments.quick else (100_000, 100, 20)
    with (
        running_parts() as parts,
        httpx.Client(base_url=parts.url, timeout=120, trust_env=False) as http,
        chromium() as browser,
    ):
        store = job_store(parts.settings())
        long = _run(store, "a long run", rows)
        store.save(long.ended(JobStatus.SUCCEEDED, Reason.COMPLETED, "All is measured.", store.now()))
        until(lambda: not store.oldest_metrics(long.id), timeout_s=3600)
        for which in ("first time", "again"):
            yield Figure(f"400 points of a run of {rows:,} rows, {which}", _curve_ms(http, long), "ms")
        paints, loaded = _first_paints(browser, parts.url)
        yield middle("first contentful paint", paints, "ms", at_most=500)
        yield Figure("bytes of the page", loaded / 1000, "kB", at_most=300)
        delays = _delays(browser, parts.url, store, 5 if arguments.quick else 30)
        yield Figure("a new metric on the page, 99th percentile", percentile(delays, 99), "ms", at_most=500)
        for what, reading in (("lists", _reading_lists), ("pages of a running job", _following)):
            cost = _api_share(parts, lambda read=reading: read(parts.url, store, readers, seconds))
            yield Figure(f"API, {readers} open {what}", cost, "% of a core", at_most=15)


def _run(store: JobStore, name: str, rows: int) -> Job:
    """A running job that has measured this many rows."""
    document = {"kind": "train", "environment": "ant", "name": name, "resources": {"accelerator": "gpu"}}
    now = store.now()
    job = Job(id=new_job_id(now), spec=JOB_SPEC.validate_python(document), created_at=now)
    store.add(job)
    held = job.claimed("bench", store.now(), new_secret())
    store.save(held, lease=_LEASE)
    started = held.running(device="gpu:0", engine="native", details={})
    store.save(started)
    for first in range(0, rows, _BATCH):
        steps = range(first, min(first + _BATCH, rows))
        _write(store, started, {step: step % 997 / 10 for step in steps})
    return started


def _write(store: JobStore, job: Job, returns: dict[int, float]) -> None:
    """Rows of metrics, by step, with the progress of the last."""
    store.renew(job.id, job.token, _LEASE)
    rows = [
        Entry(kind="metrics", time=store.now(), data={"step": step, "values": {_RETURN: value}})
        for step, value in returns.items()
    ]
    progress = Progress(step=max(returns), total=10**6, metrics=rows[-1].data["values"])
    store.record(job.id, job.token, "events", rows, progress, write_id=new_secret())


def _curve_ms(http: httpx.Client, job: Job) -> float:
    began = time.perf_counter()
    asked = {"points": 400, "metric": _RETURN}
    http.get(f"/jobs/{job.id}/metrics", params=asked).raise_for_status()
    return 1000 * (time.perf_counter() - began)


def _first_paints(browser: "Browser", url: str) -> tuple[list[float], float]:
    """Milliseconds of five visits by new readers, and the bytes of one."""
    found = list[tuple[float, float]]()
    for _ in range(5):
        page = browser.new_context().new_page()
        page.goto(url)
        page.locator(".job").first.wait_for()
        found.append(page.evaluate(_LOADED))
        page.context.close()
    return [paint for paint, _ in found], found[0][1]


def _delays(browser: "Browser", url: str, store: JobStore, count: int) -> Sequence[float]:
    """Milliseconds from the write of a metric until its value is on the page."""
    job = _run(store, "watched", 10)
    page = browser.new_context().new_page()
    page.goto(f"{url}/#/jobs/{job.id}")
    page.locator("[role=img][aria-label*='at 9']").wait_for()
    page.wait_for_timeout(1000)
    delays = list[float]()

    def write_soon(step: int) -> float:
        time.sleep(0.3)
        began = 1000 * time.time()
        _write(store, job, {step: float(step)})
        return began

    with ThreadPoolExecutor(1) as pool:
        for step in range(100, 100 + count):
            began = pool.submit(write_soon, step)
            appeared = page.evaluate(_APPEARS, f"at {step},")
            delays.append(appeared - began.result())
    page.context.close()
    return delays


def _api_share(parts: Parts, work: Callable[[], None]) -> float:
    """The API's share of a core during some work, in percent."""
    before, began = parts.cpu_s("api"), time.perf_counter()
    work()
    return 100 * (parts.cpu_s("api") - before) / (time.perf_counter() - began)


def _reading_lists(url: str, _: JobStore, readers: int, seconds: float) -> None:
    """Ask as open lists do: each for a page of jobs every two seconds."""
    end = time.monotonic() + seconds
    with httpx.Client(base_url=url, timeout=30, trust_env=False) as http:
        while (began := time.monotonic()) < end:
            http.get("/jobs", params={"limit": 25}, headers={"Cache-Control": "max-age=1"}).raise_for_status()
            time.sleep(max(0.0, began + 2 / readers - time.monotonic()))


def _following(url: str, store: JobStore, readers: int, seconds: float) -> None:
    """Readers of one job's events, while it measures once a second."""
    job = _run(store, "followed", 10)
    end = time.monotonic() + seconds

    def follow() -> None:
        with (
            suppress(httpx.HTTPError),
            httpx.Client(base_url=url, timeout=seconds + 5, trust_env=False) as http,
            http.stream("GET", f"/jobs/{job.id}/events?after=5") as answer,
        ):
            for _ in answer.iter_lines():
                if time.monotonic() > end:
                    return

    with ThreadPoolExecutor(readers) as pool:
        for _ in range(readers):
            pool.submit(follow)
        step = 100
        while time.monotonic() < end + 1.5:
            _write(store, job, {step: float(step)})
            step += 1
            time.sleep(1)
