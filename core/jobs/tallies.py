"""Counts and times of workers and the reconciler, as sums over all of them, for monitoring.

A process gathers its own and adds them to the record now and then. Sums that an outage loses do no harm.
"""

import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock

from core.errors import RecordsUnavailable


@dataclass(frozen=True)
class Series:
    """A counter, or a histogram if it has `bounds`: the upper bounds of its buckets, which never change."""

    name: str
    documentation: str
    labels: tuple[str, ...] = ()
    bounds: tuple[float, ...] = ()


@dataclass(frozen=True)
class Tally:
    """A part of a series, with the values of its labels. buckets: how many values fell into each, the last
    of which has no upper bound; empty for a counter. total: the sum of all values."""

    series: str
    labels: tuple[str, ...]
    buckets: tuple[int, ...]
    total: float


CALL_BOUNDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
STORE_SECONDS = Series(
    "gaitway_worker_store_seconds",
    "Seconds of calls of workers and reconcilers to each store.",
    ("store",),
    CALL_BOUNDS,
)
STORE_FAILURES = Series(
    "gaitway_worker_store_failures",
    "Calls of workers and reconcilers that found a store unavailable.",
    ("store",),
)
PHASE_SECONDS = Series(
    "gaitway_phase_seconds",
    "Seconds that attempts spent in each phase, from `waiting` for a worker on.",
    ("phase",),
    (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600, 14_400, 43_200, 86_400),
)
UPLOADS = Series("gaitway_uploads", "Files that workers have stored.")
UPLOADED_BYTES = Series("gaitway_uploaded_bytes", "Bytes of the files that workers have stored.")
ALL = (STORE_SECONDS, STORE_FAILURES, PHASE_SECONDS, UPLOADS, UPLOADED_BYTES)


class Tallies:
    """Gathers values; thread-safe."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._gathered: dict[tuple[Series, tuple[str, ...]], tuple[list[int], float]] = {}

    def add(self, series: Series, value: float, *labels: str) -> None:
        with self._lock:
            buckets, total = self._gathered.get((series, labels), (_empty(series), 0.0))
            if buckets:
                buckets[bisect_left(series.bounds, value)] += 1
            self._gathered[series, labels] = (buckets, total + value)

    def observe_store(self, store: str, seconds: float, *, failed: bool) -> None:
        """Time a call to a store; see `core.adapters.timing`."""
        if failed:
            self.add(STORE_FAILURES, 1, store)
        else:
            self.add(STORE_SECONDS, seconds, store)

    def take(self) -> Sequence[Tally]:
        """The sums gathered since the last call."""
        with self._lock:
            gathered, self._gathered = self._gathered, {}
        return [
            Tally(series.name, labels, tuple(buckets), total)
            for (series, labels), (buckets, total) in gathered.items()
        ]


class Report:
    """Adds what is gathered to the record, at most every `every_s`. add: `UsageStore.add_tallies`."""

    def __init__(
        self, tallies: Tallies, add: Callable[[Sequence[Tally]], None], every_s: float = 30.0
    ) -> None:
        self._tallies = tallies
        self._add = add
        self._every_s = every_s
        self._due_at = time.monotonic() + every_s

    def if_due(self) -> None:
        if time.monotonic() >= self._due_at:
            self.now()

    def now(self) -> None:
        """Sums that an unavailable record does not take are dropped."""
        self._due_at = time.monotonic() + self._every_s
        with suppress(RecordsUnavailable):
            self._add(self._tallies.take())


def _empty(series: Series) -> list[int]:
    return [0] * (len(series.bounds) + 1) if series.bounds else []
