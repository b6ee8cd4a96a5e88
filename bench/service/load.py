"""The service under load: a long queue, many workers and readers, and submissions at a fixed rate."""

import tempfile
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from bench.measure.child import run_child
from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, Target, at_most, below
from bench.measure.statistics import percentile
from bench.service.load_part import DEVICE, JOB
from bench.stack.processes import Parts, running
from core.adapters.wiring import job_queue, job_store
from core.jobs.spec import JOB_SPEC
from core.jobs.submission import submit
from core.settings import WorkerSettings

_PREFIX = "GAITWAY_"
# Workers are threads in a few processes: more in one process would wait for Python's lock.
_WORKERS_OF_A_PROCESS = 10
_TRAINING_S = 2.0
# Workers and readers start this long before the submissions and stop this long after them.
_MARGIN_S = 5.0


def measure(options: Options) -> Result:
    """Measure on the embedded stack's servers, with the reconciler and the API as this machine starts it."""
    machine = this_machine()
    seconds = 60 * (options.minutes or (0.25 if options.quick else 5.0))
    queued, workers, readers, rate = (300, 10, 50, 50.0) if options.quick else (10_000, 50, 500, 200.0)
    with tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder, running(Path(folder)) as parts:
        print(f"{queued:,} jobs are queued first.", flush=True)
        jobs = _fill(parts, queued)
        print(
            f"{workers} workers, {readers} readers and {rate:g} submissions a second for {seconds:g} s.",
            flush=True,
        )
        found, resident_mb = _load(parts, jobs, workers, readers, rate, seconds)
    claims = [claim for part in found["work"] for claim in part["claims"]]
    picked_up = {job: waited for part in found["work"] for job, waited in part["picked_up"].items()}
    urgent = [picked_up[job] for job in found["look"]["urgent"] if job in picked_up]
    readers_found = found["follow"]
    figures = [
        _ms("`POST /jobs`, 50th percentile", found["post"]["seconds"], 50),
        _ms("`POST /jobs`, 99th percentile", found["post"]["seconds"], 99, at_most(25)),
        _ms("`GET /jobs`, 99th percentile", found["look"]["seconds"], 99, at_most(30)),
        _ms("claim, 50th percentile", claims, 50),
        _ms("claim, 99th percentile", claims, 99, at_most(10)),
        _ms("urgent job to its claim, 99th percentile", urgent, 99, at_most(1000)),
        _ms("event to a reader, 50th percentile", readers_found["delays"], 50),
        _ms("event to a reader, 99th percentile", readers_found["delays"], 99),
        _count("events missed or doubled", readers_found["gaps"], below(1)),
        _count("streams that broke", readers_found["broken"], below(1)),
        Figure(
            name="a process of the API, resident at most", value=resident_mb, unit="MB", target=at_most(140)
        ),
        _count("jobs submitted", len(found["post"]["seconds"])),
        _count("jobs ended", len(claims)),
        _count("jobs followed", readers_found["followed"]),
        _count("urgent jobs not taken in time", len(found["look"]["urgent"]) - len(urgent)),
    ]
    return Result(
        name="load",
        title="Load",
        command="./run bench load",
        quick=options.quick,
        machine=machine,
        figures=figures,
        rows=[],
        notes=[
            f"{queued:,} jobs are queued before it begins. For {seconds:g} s, submissions come at {rate:g} "
            f"a second, due at fixed times and timed from then; {workers} workers take jobs from RQ, claim "
            f"them, report four times within {_TRAINING_S:g} s, and end them; {readers} readers follow one "
            "job after the other; the queue is listed five times a second with changing filters, and an "
            "urgent job is sent each second. What is left waits at the end.",
            "The workers are threads of a few processes, which do what RQ's workers and supervisors do to "
            "the stores, without a process for each job. Everything shares the machine. The API has one "
            "process for every four cores, and four at most.",
        ],
    )


def _fill(parts: Parts, count: int) -> list[str]:
    """Queue `count` jobs as the API does; returns their ids."""
    settings = _settings(parts)
    store, queue = job_store(settings), job_queue(settings)
    spec = JOB_SPEC.validate_python(JOB)
    with ThreadPoolExecutor(8) as pool:
        return list(pool.map(lambda _: submit(spec, store=store, queue=queue).id, range(count)))


def _settings(parts: Parts) -> WorkerSettings:
    said = {
        name.removeprefix(_PREFIX).lower(): value
        for name, value in parts.environment.items()
        if name.startswith(_PREFIX)
    }
    return WorkerSettings.model_validate({**said, "device": DEVICE})


def _load(
    parts: Parts, jobs: list[str], workers: int, readers: int, rate: float, seconds: float
) -> tuple[dict[str, Any], float]:
    """The measurements of each party, and the peak resident memory of an API process in MB."""
    whole_s = seconds + 2 * _MARGIN_S
    common = {"url": parts.url, "seconds": whole_s}
    worker = {**common, "part": "work", "workers": _WORKERS_OF_A_PROCESS, "training_s": _TRAINING_S}
    requests = {
        **{f"work-{n}": worker for n in range(workers // _WORKERS_OF_A_PROCESS)},
        "follow": {**common, "part": "follow", "readers": readers, "jobs": sorted(jobs)},
        "look": {**common, "part": "look", "after_s": _MARGIN_S, "seconds": seconds},
        "post": {**common, "part": "post", "after_s": _MARGIN_S, "seconds": seconds, "per_second": rate},
    }
    begin = partial(
        run_child, "bench.service.load_part", timeout_s=whole_s + 120, environment=parts.environment
    )
    with _Watched(parts) as watched, ThreadPoolExecutor(len(requests)) as pool:
        running_parts: dict[str, Future[dict[str, Any]]] = {
            name: pool.submit(begin, request) for name, request in requests.items()
        }
        found: dict[str, Any] = {name: part.result() for name, part in running_parts.items()}
    found["work"] = [part for name, part in found.items() if name.startswith("work-")]
    return found, watched.most_mb


class _Watched:
    """Samples the memory of the API's processes every second."""

    def __init__(self, parts: Parts) -> None:
        self.most_mb = 0.0
        self._api = list(parts.family("api"))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self) -> "_Watched":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._over.wait(1):
            self.most_mb = max(self.most_mb, *(api.memory_info().rss / 1e6 for api in self._api))


def _ms(name: str, seconds: list[float], percent: float, target: Target | None = None) -> Figure:
    if not seconds:
        return Figure(name=name, value=None, unit="ms", target=target, missing="there was none")
    return Figure(name=name, value=1000 * percentile(seconds, percent), unit="ms", target=target)


def _count(name: str, number: int, target: Target | None = None) -> Figure:
    return Figure(name=name, value=float(number), unit="", target=target)
