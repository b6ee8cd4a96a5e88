"""Whether processes, descriptors, threads and memory grow over hours of small jobs.

A job every two seconds to two workers, whose training process trains nothing. A figure is the growth over the
second half of the minutes: the slope of a straight line through them, times their length. Of a minute's five
samples, the least counts, as between two jobs; of memory, the median. Workers are taken together: one that
trains shares most of its memory with its work-horse.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from statistics import median

import psutil

from bench.stack import Parts, running_parts
from bench.summary import Figure
from gaitway.client import Client

# The campaign's worker: its training process trains nothing and ends after a second.
_WORKER = "tests.faults.campaign.worker"
_WORKERS = 2
_JOB_EVERY_S = 2.0
_SAMPLES = 5
# A growth up to this counts as noise; for memory, up to a tenth of it where that is more.
_MOST = {"processes": 1.0, "descriptors": 5.0, "threads": 3.0, "MB": 8.0}

# A part's number of processes, descriptors and threads, and its private memory in MB (USS).
Sample = tuple[float, ...]


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    """Sample the embedded stack's processes while jobs keep its workers busy."""
    minutes = arguments.minutes or (1.0 if arguments.quick else 60.0)
    with running_parts(workers=_WORKERS, worker=_WORKER) as parts, Client(parts.url) as client:
        minutely, sent = _soak(parts, client, 60 * minutes)
        ended = [client.wait(job, timeout=120) for job in sent]
    yield Figure(f"soak: jobs in {minutes:g} minutes", len(ended))
    yield Figure("soak: jobs that failed", sum(not job.succeeded for job in ended), at_most=0)
    for part, samples in minutely.items():
        half = samples[len(samples) // 2 :]
        for (what, most), values in zip(_MOST.items(), zip(*half, strict=True), strict=True):
            noise = max(most, 0.1 * median(values)) if what == "MB" else most
            yield Figure(f"soak: growth of {part}", growth(values), what, at_most=noise)


def _soak(parts: Parts, client: Client, seconds: float) -> tuple[dict[str, list[Sample]], list[str]]:
    """A sample of each part for each minute, and the jobs."""
    began, pace = time.monotonic(), min(12.0, seconds / 25)
    names = {name: [name] for name in parts.processes if not name.startswith("worker")}
    names["workers"] = [name for name in parts.processes if name.startswith("worker")]
    minutely: dict[str, list[Sample]] = {name: [] for name in names}
    seen: dict[str, list[Sample]] = {name: [] for name in names}
    sent: list[str] = []
    next_job, next_look = began, began + pace
    while (now := time.monotonic()) - began < seconds:
        if now >= next_job:
            sent.append(client.submit(environment="ant", seed=len(sent) % 1000).id)
            next_job += _JOB_EVERY_S
        if now >= next_look:
            next_look += pace
            for name, members in names.items():
                seen[name].append(_look(parts, members))
                if len(seen[name]) == _SAMPLES:
                    minutely[name].append(_minute(seen[name]))
                    seen[name] = []
        time.sleep(max(0.0, min(next_job, next_look) - time.monotonic()))
    return minutely, sent


def _look(parts: Parts, names: Sequence[str]) -> Sample:
    found: list[Sample] = []
    for process in (process for name in names for process in parts.family(name)):
        with suppress(psutil.NoSuchProcess):
            memory_mb = process.memory_full_info().uss / 1e6
            found.append((1, process.num_fds(), process.num_threads(), memory_mb))
    return tuple(sum(values) for values in zip(*found, strict=True))


def _minute(samples: Sequence[Sample]) -> Sample:
    *counts, memory_mb = zip(*samples, strict=True)
    return (*(min(values) for values in counts), median(memory_mb))


def growth(values: Sequence[float]) -> float:
    """The rise of the least-squares line from the first of equally spaced values to the last."""
    places = range(len(values))
    middle_x, middle_y = sum(places) / len(values), sum(values) / len(values)
    spread = sum((x - middle_x) ** 2 for x in places)
    both = sum((x - middle_x) * (y - middle_y) for x, y in zip(places, values, strict=True))
    return both / spread * (len(values) - 1) if spread else 0.0
