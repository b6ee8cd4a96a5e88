"""Hours of small jobs: whether anything of the service grows that should not."""

import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import psutil

from bench.machine import this_machine
from bench.parts import Parts, running
from bench.result import Figure, Options, Result, at_most
from gaitway.client import Client

# The campaign's: it trains nothing for a second, in a process of its own.
_WORKER = "tests.faults.campaign.worker"
_WORKERS = 2
_JOB_EVERY_S = 2.0
# What may come and go without anything having grown. Memory: the greater of these and of a tenth.
_MOST = {"processes": 1.0, "descriptors": 5.0, "threads": 3.0, "memory_mb": 8.0}


@dataclass(frozen=True)
class Sample:
    """One look at a part of the service.

    processes: it and those it has started; descriptors, threads: of all of them; memory_mb: what is theirs
    alone (USS), so that what PostgreSQL's processes share does not count as growth.
    """

    at_s: float
    processes: float
    descriptors: float
    threads: float
    memory_mb: float


def measure(options: Options) -> Result:
    """The embedded stack's processes, with two workers that are never idle for long."""
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
    figures += [_drift(part, what, samples) for part, samples in minutely.items() for what in _MOST]
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
            "Each part is looked at five times a minute: a minute's value is the least of processes, "
            "descriptors and threads, which is between two jobs, and the median of memory. A figure is the "
            "slope of a straight line through the last half of the minutes, times their length: how much has "
            "grown meanwhile.",
        ],
    )


def _soak(parts: Parts, client: Client, seconds: float) -> tuple[dict[str, list[Sample]], int, int]:
    """A sample for each minute, of each part; how many jobs there were; how many failed."""
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


def _drift(part: str, what: str, samples: Sequence[Sample]) -> Figure:
    """How much it has grown over the last half."""
    half = samples[len(samples) // 2 :]
    values = [getattr(sample, what) for sample in half]
    most = max(_MOST[what], 0.1 * median(values)) if what == "memory_mb" else _MOST[what]
    grown = slope([sample.at_s for sample in half], values) * (half[-1].at_s - half[0].at_s)
    name, unit = (what, "") if what != "memory_mb" else ("memory", "MB")
    return Figure(name=f"{part}: growth of {name}", value=grown, unit=unit, target=at_most(most))


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Of the straight line that is nearest to these points by least squares; 0 for fewer than two."""
    middle_x, middle_y = sum(x) / len(x), sum(y) / len(y)
    spread = sum((one - middle_x) ** 2 for one in x)
    both = sum((a - middle_x) * (b - middle_y) for a, b in zip(x, y, strict=True))
    return both / spread if spread else 0.0
