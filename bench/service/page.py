"""Times the page in a real Chromium: first paint, a metric's way to it, long runs, the cost of readers."""

import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import psutil
from playwright.sync_api import Browser, Page

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, Target
from bench.measure.statistics import percentile, spread
from bench.stack.browser import chromium
from bench.stack.processes import Parts, running
from bench.stack.waiting import until
from core.adapters.wiring import job_store
from core.jobs.attempts import new_secret
from core.jobs.job import Job, Progress, new_job_id
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Entry, JobStore
from core.reasons import Reason
from core.settings import WorkerSettings

_LEASE = timedelta(seconds=50)  # At most four of the service's own.
_RETURN = "eval/episode_reward"
_BATCH = 1000
# The first paint in ms, and the bytes of all that came before the page was still.
_LOADED = """() => [
  performance.getEntriesByName("first-contentful-paint")[0].startTime,
  [...performance.getEntriesByType("resource"), ...performance.getEntriesByType("navigation")]
    .filter((one) => /^\/(pages\/.*)?$/.test(new URL(one.name).pathname))
    .reduce((sum, one) => sum + one.encodedBodySize, 0),
]"""
# Resolves with the moment at which a text stands in a curve's description.
_APPEARS = """(text) => new Promise((resolve) => {
  const look = () => document.querySelector(`[role=img][aria-label*="${text}"]`)
    ? resolve(Date.now()) : requestAnimationFrame(look);
  look();
})"""
_LONGEST_TASK = """() => {
  window.longest = 0;
  new PerformanceObserver((list) => {
    for (const one of list.getEntries()) window.longest = Math.max(window.longest, one.duration);
  }).observe({ type: "longtask" });
}"""


def measure(options: Options) -> Result:
    """Measure on the embedded servers and one API process, with Chromium on the same machine."""
    sizes = {"jobs": 200, "runs": 2, "rows": 3000, "readers": 5, "seconds": 2}
    if not options.quick:
        sizes = {"jobs": 10_000, "runs": 20, "rows": 100_000, "readers": 100, "seconds": 20}
    machine = this_machine()
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running(Path(folder, "stack")) as parts,
        httpx.Client(base_url=parts.url, timeout=120, trust_env=False) as http,
        chromium() as browser,
    ):
        store = job_store(settings_of(parts))
        listings = _listings(store, http, sizes["jobs"])
        runs = [_ended(store, _run(store, f"seed {i}", sizes["rows"])) for i in range(sizes["runs"])]
        _wait_until_stored(store, runs)
        cold, warm = _curves(http, runs[0])
        paints, loaded = _first_paints(browser, parts.url)
        delays = _delays(browser, parts.url, store, 5 if options.quick else 30)
        compared, longest = _compare(browser, parts.url, [job.id for job in runs])
        lists = _cost(parts, lambda: _reading_lists(parts.url, sizes["readers"], sizes["seconds"]))
        followers = _cost(parts, lambda: _following(parts.url, store, sizes["readers"], sizes["seconds"]))
    name_of_run = f"a run of {sizes['rows']:,} rows"
    figures = [
        Figure.of("first contentful paint", spread(paints), "ms", _at_most(500)),
        Figure(name="bytes of the page", value=loaded / 1000, unit="kB", target=_at_most(300)),
        Figure(
            name=f"`GET /jobs` by search and label among {sizes['jobs']:,}, 99th percentile",
            value=1000 * percentile(listings, 99),
            unit="ms",
            target=_at_most(100),
        ),
        Figure(
            name="a new metric on the page, 99th percentile",
            value=percentile(delays, 99),
            unit="ms",
            target=_at_most(500),
        ),
        Figure(name=f"400 points of {name_of_run}, first time", value=1000 * cold, unit="ms"),
        Figure(name=f"400 points of {name_of_run}, again", value=1000 * warm, unit="ms"),
        Figure(name=f"{sizes['runs']} such runs drawn over each other, first time", value=compared, unit="s"),
        Figure(name="longest task of the browser while smoothing them", value=longest, unit="ms"),
        Figure(
            name=f"API, {sizes['readers']} open lists", value=lists, unit="% of a core", target=_at_most(15)
        ),
        Figure(
            name=f"API, {sizes['readers']} open pages of a running job",
            value=followers,
            unit="% of a core",
            target=_at_most(15),
        ),
    ]
    return Result(
        name="page",
        title="The page",
        command="./run bench page",
        quick=options.quick,
        machine=machine,
        figures=figures,
        rows=[{"first_paint_ms": value} for value in paints] + [{"metric_ms": value} for value in delays],
        notes=[
            "Chromium without a window or a GPU runs beside the service, on the same cores. Open pages are "
            "stood for by what they ask: a list every two seconds, and the events of one job that "
            "measures once a second."
        ],
    )


def _at_most(value: float) -> Target:
    return Target(comparison="at most", value=value)


def settings_of(parts: Parts) -> WorkerSettings:
    """What a worker of this stack would have."""
    values = {name.removeprefix("GAITWAY_").lower(): value for name, value in parts.environment.items()}
    known = {name: values[name] for name in WorkerSettings.model_fields if name in values}
    return WorkerSettings.model_validate(known)


def _job(store: JobStore, number: int, **spec: Any) -> Job:
    document = {"kind": "train", "environment": "ant", **spec}
    now = store.now()
    job = Job(id=new_job_id(now), spec=JOB_SPEC.validate_python(document), created_at=now)
    store.add(job)
    return job


def _held(store: JobStore, name: str) -> Job:
    job = _job(store, 0, name=name, resources={"accelerator": "gpu"})
    held = job.claimed("bench", store.now(), new_secret())
    store.save(held, lease=_LEASE)
    started = held.running(device="gpu:0", engine="native", details={})
    store.save(started)
    return started


def _listings(store: JobStore, http: httpx.Client, count: int) -> list[float]:
    """Seconds of filtered listings among this many jobs."""
    for number in range(count):
        _job(store, number, name=f"sweep {number}", labels={"project": f"p{number % 50}"})
    seconds = list[float]()
    for number in range(20 if count < 1000 else 200):
        began = time.perf_counter()
        asked = {"search": f"eep {number % 10}", "label": f"project:p{number % 50}", "limit": 25}
        http.get("/jobs", params=asked).raise_for_status()
        seconds.append(time.perf_counter() - began)
    return seconds


def _run(store: JobStore, name: str, rows: int) -> Job:
    """A running job that has measured this many rows."""
    job = _held(store, name)
    for first in range(0, rows, _BATCH):
        steps = range(first, min(first + _BATCH, rows))
        entries = [_measured(store, step, {_RETURN: step % 997 / 10, "training/loss": 1.0}) for step in steps]
        _write(store, job, entries, steps[-1])
    return job


def _ended(store: JobStore, job: Job) -> Job:
    store.save(job.ended(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything is measured.", store.now()))
    return job


def _wait_until_stored(store: JobStore, jobs: Sequence[Job]) -> None:
    """Return when the events of these ended jobs lie in the object store, where those of most jobs do."""
    until(lambda: not any(store.oldest_entries(job.id, "events", limit=1) for job in jobs), timeout_s=3600)


def _measured(store: JobStore, step: int, values: dict[str, float]) -> Entry:
    return Entry(kind="metrics", time=store.now(), data={"step": step, "values": values})


def _write(store: JobStore, job: Job, entries: Sequence[Entry], step: int) -> None:
    store.renew(job.id, job.token, _LEASE)
    progress = Progress(step=step, total=10**6, steps_per_second=100.0, metrics=entries[-1].data["values"])
    store.record(job.id, job.token, "events", entries, progress, write_id=new_secret())


def _curves(http: httpx.Client, job: Job) -> tuple[float, float]:
    """Seconds for the curve of a long run: read from the beginning, and known already."""
    seconds = list[float]()
    for _ in range(2):
        began = time.perf_counter()
        asked = {"points": 400, "metric": _RETURN}
        http.get(f"/jobs/{job.id}/metrics", params=asked).raise_for_status()
        seconds.append(time.perf_counter() - began)
    return seconds[0], seconds[1]


def _first_paints(browser: Browser, url: str) -> tuple[list[float], float]:
    """Milliseconds of five visits by new readers, and the bytes of one."""
    found = list[tuple[float, float]]()
    for _ in range(5):
        page = browser.new_context().new_page()
        page.goto(url)
        page.locator(".job").first.wait_for()
        found.append(page.evaluate(_LOADED))
        page.context.close()
    return [paint for paint, _ in found], found[0][1]


def _delays(browser: Browser, url: str, store: JobStore, count: int) -> list[float]:
    """Milliseconds from the write of a metric until its value is on the page."""
    job = _run(store, "watched", 10)
    page = browser.new_context().new_page()
    page.goto(f"{url}/#/jobs/{job.id}")
    page.locator("[role=img][aria-label*='at 9']").wait_for()
    page.wait_for_timeout(1000)
    delays = list[float]()
    with ThreadPoolExecutor(1) as pool:
        for number in range(count):
            step = 100 + number
            began = pool.submit(_write_soon, store, job, step)
            appeared = page.evaluate(_APPEARS, f"at {step},")
            delays.append(appeared - began.result())
    page.context.close()
    return delays


def _write_soon(store: JobStore, job: Job, step: int) -> float:
    """Write a row a moment later; returns when, in ms."""
    time.sleep(0.3)
    entry = _measured(store, step, {_RETURN: float(step)})
    began = 1000 * time.time()
    _write(store, job, [entry], step)
    return began


def _compare(browser: Browser, url: str, ids: Sequence[str]) -> tuple[float, float]:
    """Seconds until these runs are drawn; the browser's longest task, in ms, while they are smoothed."""
    page: Page = browser.new_context().new_page()
    page.set_default_timeout(300_000)
    began = time.perf_counter()
    page.goto(f"{url}/#/compare?ids={','.join(ids)}&metric={_RETURN}")
    page.locator("[role=img][aria-label*='last']").wait_for()
    seconds = time.perf_counter() - began
    page.evaluate(_LONGEST_TASK)
    for smoothing in range(10):
        page.get_by_label("Smoothing").fill(str(smoothing / 10))
        page.wait_for_timeout(50)
    longest = page.evaluate("window.longest")
    page.context.close()
    return seconds, longest


def _cost(parts: Parts, work: Any) -> float:
    """The API's share of a core during some work, in percent."""
    before, began = _cpu_s(parts), time.perf_counter()
    work()
    return 100 * (_cpu_s(parts) - before) / (time.perf_counter() - began)


def _cpu_s(parts: Parts) -> float:
    used = 0.0
    for process in parts.family("api"):
        with suppress(psutil.NoSuchProcess):
            times = process.cpu_times()
            used += times.user + times.system
    return used


def _reading_lists(url: str, readers: int, seconds: float) -> None:
    """What open lists ask: a page of jobs every two seconds each."""
    pause = 2 / readers
    until = time.monotonic() + seconds
    with httpx.Client(base_url=url, timeout=30, trust_env=False) as http:
        while (began := time.monotonic()) < until:
            http.get("/jobs", params={"limit": 25}, headers={"Cache-Control": "max-age=1"}).raise_for_status()
            time.sleep(max(0.0, began + pause - time.monotonic()))


def _following(url: str, store: JobStore, readers: int, seconds: float) -> None:
    """Readers of one job's events, while it measures once a second."""
    job = _run(store, "followed", 10)
    until = time.monotonic() + seconds

    def follow() -> None:
        with (
            suppress(httpx.HTTPError),
            httpx.Client(base_url=url, timeout=seconds + 5, trust_env=False) as http,
            http.stream("GET", f"/jobs/{job.id}/events?after=5") as answer,
        ):
            for _ in answer.iter_lines():
                if time.monotonic() > until:
                    return

    with ThreadPoolExecutor(readers) as pool:
        for _ in range(readers):
            pool.submit(follow)
        step = 100
        while time.monotonic() < until + 1.5:
            _write(store, job, [_measured(store, step, {_RETURN: float(step)})], step)
            step += 1
            time.sleep(1)
