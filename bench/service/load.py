"""The service under load: a long queue, workers that claim, readers of feeds, lists, and submissions.

The workers are threads of a few processes, which do to the stores what RQ's workers and supervisors do,
without a process for each job. Submissions are due at fixed times, and timed from then.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from bench.child import run_child
from bench.service.load_parties import DEVICE, JOB
from bench.stack import Parts, running_parts
from bench.summary import Figure, percentile
from core.adapters.wiring import job_queue, job_store
from core.jobs.spec import JOB_SPEC
from core.jobs.submission import submit

# More threads in one process would wait for Python's lock.
_WORKERS_OF_A_PROCESS = 10
_TRAINING_S = 2.0
# Workers and readers start this long before the submissions and stop this long after them.
_MARGIN_S = 5.0


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """On the embedded stack's servers, with the reconciler and the API as this machine starts it."""
    seconds = 15.0 if arguments.quick else 60 * arguments.minutes
    queued, workers, readers, rate = (300, 10, 50, 50.0) if arguments.quick else (10_000, 50, 500, 200.0)
    with running_parts() as parts:
        jobs = _fill(parts, queued)
        found = _load(parts, jobs, workers, readers, rate, seconds)
        resident = max(one.memory_info().rss / 1e6 for one in parts.family("api"))
    claims = [claim for name, part in found.items() if name.startswith("work") for claim in part["claims"]]
    name = f"load: {queued:,} queued, {workers} workers, {readers} readers, {rate:g} submissions/s"
    yield Figure(name, seconds, "s")
    yield _ms("load: `POST /jobs`", found["post"]["seconds"], 25)
    yield _ms("load: `GET /jobs`", found["look"]["seconds"], 30)
    yield _ms("load: claim", claims, 10)
    yield _ms("load: an event to a reader of its feed", found["follow"]["delays"])
    yield Figure("load: events missed or doubled", found["follow"]["gaps"], at_most=0)
    yield Figure("load: streams that broke", found["follow"]["broken"], at_most=0)
    yield Figure("load: a process of the API, resident afterwards", resident, "MB", at_most=140)


def _fill(parts: Parts, count: int) -> list[str]:
    """Queue `count` jobs as the API does; returns their ids."""
    settings = parts.settings(device=DEVICE)
    store, queue = job_store(settings), job_queue(settings)
    spec = JOB_SPEC.validate_python(JOB)
    with ThreadPoolExecutor(8) as pool:
        return list(pool.map(lambda _: submit(spec, store=store, queue=queue).id, range(count)))


def _load(
    parts: Parts, jobs: list[str], workers: int, readers: int, rate: float, seconds: float
) -> dict[str, Any]:
    """The measurements of each party."""
    whole_s = seconds + 2 * _MARGIN_S
    common = {"url": parts.url, "seconds": whole_s}
    worker = {**common, "part": "work", "workers": _WORKERS_OF_A_PROCESS, "training_s": _TRAINING_S}
    requests = {
        **{f"work-{n}": worker for n in range(workers // _WORKERS_OF_A_PROCESS)},
        "follow": {**common, "part": "follow", "readers": readers, "jobs": sorted(jobs)},
        "look": {**common, "part": "look", "after_s": _MARGIN_S, "seconds": seconds},
        "post": {**common, "part": "post", "after_s": _MARGIN_S, "seconds": seconds, "per_second": rate},
    }
    environment = {**parts.environment, "GAITWAY_DEVICE": DEVICE}
    begin = partial(run_child, "bench.service.load_parties", timeout_s=whole_s + 120, environment=environment)
    with ThreadPoolExecutor(len(requests)) as pool:
        return dict(zip(requests, pool.map(begin, requests.values()), strict=True))


def _ms(name: str, seconds: list[float], at_most: float | None = None) -> Figure:
    name = f"{name}, 99th percentile"
    if not seconds:
        return Figure(name, None, "ms", at_most=at_most, missing="there was none")
    return Figure(name, 1000 * percentile(seconds, 99), "ms", at_most=at_most)
