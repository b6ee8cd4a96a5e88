"""Measures whether processes, descriptors, threads and memory grow over hours of small jobs."""

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import psutil

from bench.measure.machine import this_machine
from bench.measure.result import Figure, Options, Result, at_most
from bench.stack.processes import Parts, running
from gaitway.client import Client

# The fault campaign's worker: its training process trains nothing and ends after a second.
_WORKER = "tests.faults.campaign.worker"
_WORKERS = 2
_JOB_EVERY_S = 2.0
# A growth up to this counts as noise; for memory, up to a tenth of it where that is more.
_MOST = {"processes": 1.0, "descriptors": 5.0, "threads": 3.0, "memory_mb": 8.0}


@dataclass(frozen=True)
class Sample:
    """The resources that one part of the service uses at one moment.

    processes: its own and all that it has started; descriptors, threads: their sums; memory_mb: the sum of
    their private memory (USS), without the memory that PostgreSQL's processes share.
    """

    at_s: float
    processes: float
    descriptors: float
    threads: float
    memory_mb: float


def measure(options: Options) -> Result:
    """Sample the embedded stack's processes while jobs keep its two workers busy."""
    minutes = options.minutes or (1.0 if options.quick else 60.0)
    machine = this_machine()
    with (
        tempfile.TemporaryDirectory(prefix="gaitway-bench-") as folder,
        running(Path(folder), workers=_WORKERS, worker=_WORKER) as parts,
        Client(parts.url) as client,
    ):
        minutely, num_jobs, failed = _soak(parts, client, 60 * minutes)
    figures = [Figure(name="jobs ended well", value=float(num_jobs - failed), unit="")]
    figures += [Figure(name="jobs that failed", value=float(failed), unit="", target=at_most(0))]
    figures += growth(minutely)
    rows: list[dict[str, Any]] = [
        {"part": part, **vars(sample)} for part, samples in minutely.items() for sample in samples
    ]
    return Result(
        name="soak",
        title="Soak",
        command="./run bench soak",
        quick=options.quick,
        machine=machine,
        figures=figures,
        rows=rows,
        notes=[
            f"A job every {_JOB_EVERY_S:g} s for {minutes:g} minutes to {_WORKERS} workers, whose training "
            "process trains nothing; each job has a log, metrics, checkpoints and a policy.",
            "Each part is sampled five times a minute. A minute's value is the minimum of processes, "
            "descriptors and threads, as between two jobs, and the median of memory. A figure is the growth "
            "over the second half of the minutes: the slope of a straight line through them, times their "
            "length. The workers are taken together: one that trains shares most of its memory with its "
            "work-horse and has 50 MB less of its own, and which of them trains more changes from minute to "
            "minute.",
        ],
    )


def _soak(parts: Parts, client: Client, seconds: float) -> tuple[dict[str, list[Sample]], int, int]:
    """A sample of each part for each minute, the number of jobs, and the number of those that failed."""
    began = time.monotonic()
    pace = min(12.0, seconds / 25)
    minutely: dict[str, list[Sample]] = {name: [] for name in parts.processes}
    looked: dict[str, list[Sample]] = {name: [] for name in parts.processes}
    sent: list[str] = []
    next_job, next_look = began, began + pace
    while (now := time.monotonic()) - began < seconds:
        if now >= next_job:
            sent.append(client.submit(environment="ant", seed=len(sent) % 1000).id)
            next_job += _JOB_EVERY_S
        if now >= next_look:
            next_look += pace
            for name in parts.processes:
                looked[name].append(_look(parts, name, now - began))
            if len(looked["api"]) == 5:
                for name, samples in looked.items():
                    minutely[name].append(_minute(samples))
                looked = {name: [] for name in parts.processes}
                print(_line(minutely), flush=True)
        time.sleep(max(0.0, min(next_job, next_look) - time.monotonic()))
    ended = [client.wait(job, timeout=120) for job in sent]
    return minutely, len(ended), sum(not job.succeeded for job in ended)


def _look(parts: Parts, name: str, at_s: float) -> Sample:
    found: list[tuple[int, int, float]] = []
    for process in parts.family(name):
        with suppress(psutil.NoSuchProcess):
            found.append((process.num_fds(), process.num_threads(), process.memory_full_info().uss / 1e6))
    descriptors, threads, memory = (sum(values) for values in zip(*found, strict=True))
    return Sample(at_s, len(found), descriptors, threads, memory)


def _minute(samples: Sequence[Sample]) -> Sample:
    return Sample(
        at_s=samples[-1].at_s,
        processes=min(sample.processes for sample in samples),
        descriptors=min(sample.descriptors for sample in samples),
        threads=min(sample.threads for sample in samples),
        memory_mb=median(sample.memory_mb for sample in samples),
    )


def _line(minutely: dict[str, list[Sample]]) -> str:
    newest = {name: samples[-1] for name, samples in minutely.items()}
    shown = [
        f"{name} {one.processes:g} p {one.descriptors:g} fd {one.threads:g} t {one.memory_mb:.0f} MB"
        for name, one in newest.items()
    ]
    return f"{newest['api'].at_s:.0f} s: " + "; ".join(shown)


def growth(minutely: dict[str, list[Sample]]) -> list[Figure]:
    """The growth of each part, the workers taken together."""
    workers = [samples for part, samples in minutely.items() if part.startswith("worker")]
    parts = {part: samples for part, samples in minutely.items() if not part.startswith("worker")}
    parts["workers"] = [_sum(samples) for samples in zip(*workers, strict=True)]
    return [_drift(part, what, samples) for part, samples in parts.items() for what in _MOST]


def _sum(samples: Sequence[Sample]) -> Sample:
    return Sample(
        at_s=samples[0].at_s,
        processes=sum(sample.processes for sample in samples),
        descriptors=sum(sample.descriptors for sample in samples),
        threads=sum(sample.threads for sample in samples),
        memory_mb=sum(sample.memory_mb for sample in samples),
    )


def _drift(part: str, what: str, samples: Sequence[Sample]) -> Figure:
    """The part's growth over the second half of the samples."""
    half = samples[len(samples) // 2 :]
    values = [getattr(sample, what) for sample in half]
    most = max(_MOST[what], 0.1 * median(values)) if what == "memory_mb" else _MOST[what]
    grown = slope([sample.at_s for sample in half], values) * (half[-1].at_s - half[0].at_s)
    name, unit = (what, "") if what != "memory_mb" else ("memory", "MB")
    return Figure(name=f"{part}: growth of {name}", value=grown, unit=unit, target=at_most(most))


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """The slope of the least-squares line through these points; 0 for fewer than two."""
    middle_x, middle_y = sum(x) / len(x), sum(y) / len(y)
    spread = sum((one - middle_x) ** 2 for one in x)
    both = sum((a - middle_x) * (b - middle_y) for a, b in zip(x, y, strict=True))
    return both / spread if spread else 0.0
