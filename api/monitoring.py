"""What Prometheus reads at `/metrics`: what the API's processes count, and the numbers of the record.

Several processes of one API count into shared files, so that whichever of them answers tells the sums of all.
"""

import os
import time
from collections import Counter as Sums
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from threading import Lock

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric
from prometheus_client.multiprocess import MultiProcessCollector
from prometheus_client.registry import Collector

from core.devices import gpu_indices
from core.errors import RecordsUnavailable
from core.jobs.slots import WantedSlots, wanted_slots
from core.jobs.store import JobStore
from core.jobs.tallies import ALL, CALL_BOUNDS, Series, Tally
from core.jobs.usage import Ended, RecordNumbers, RunningAttempt, UnfinishedJobs
from core.jobs.workers import WorkerInfo, kind_of

# prometheus-client reads this variable when it is imported; `api.main` sets it for several processes.
SHARED_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
# How old the numbers of the record may be.
_KEPT_S = 5.0
_REQUEST_BOUNDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
# A running attempt counts this much less, so that no clock's error lets a sum sink when the attempt ends.
_MARGIN_S = 5.0


class Instruments:
    """The counters of one process of the API."""

    def __init__(self) -> None:
        self._own = CollectorRegistry()
        self._requests = Counter(
            "gaitway_http_requests",
            "Requests by the route that answered them; without one, `none`.",
            ["method", "route", "status"],
            registry=self._own,
        )
        self._request_seconds = Histogram(
            "gaitway_http_request_seconds",
            "Seconds until the answer began.",
            ["route"],
            buckets=_REQUEST_BOUNDS,
            registry=self._own,
        )
        self._store_seconds = Histogram(
            "gaitway_store_seconds",
            "Seconds of the API's calls to each store.",
            ["store"],
            buckets=CALL_BOUNDS,
            registry=self._own,
        )
        self._store_failures = Counter(
            "gaitway_store_failures",
            "Calls of the API that found a store unavailable.",
            ["store"],
            registry=self._own,
        )

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """seconds: until the answer began. status: 0 if the connection broke before."""
        known = method if method in _METHODS else "other"
        self._requests.labels(known, route, str(status)).inc()
        self._request_seconds.labels(route).observe(seconds)

    def observe_store(self, store: str, seconds: float, *, failed: bool) -> None:
        """See `core.adapters.timing`."""
        if failed:
            self._store_failures.labels(store).inc()
        else:
            self._store_seconds.labels(store).observe(seconds)

    def collectors(self) -> Iterator[Collector]:
        """The counters of this process, or of all processes of this API."""
        if os.environ.get(SHARED_FOLDER):
            yield MultiProcessCollector(None)
        else:
            yield self._own


@dataclass(frozen=True)
class Reading:
    """The numbers that were read from the record."""

    numbers: RecordNumbers
    wanted: Sequence[WantedSlots]
    workers: Sequence[WorkerInfo]


class RecentReading:
    """The record as it was in the last seconds; thread-safe, with one reading at a time."""

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._lock = Lock()
        self._reading: Reading | None = None
        self._read_at = 0.0

    def read(self) -> Reading:
        """Raises RecordsUnavailable."""
        with self._lock:
            if self._reading is None or time.monotonic() - self._read_at > _KEPT_S:
                self._reading = None
                wanted = wanted_slots(self._store.queue_counts())
                self._reading = Reading(self._store.numbers(), wanted, self._store.workers())
                self._read_at = time.monotonic()
            return self._reading


class RecordCollector(Collector):
    """Families of the record's numbers; `gaitway_record_up` alone while PostgreSQL is unavailable."""

    def __init__(self, record: RecentReading) -> None:
        self._record = record

    def collect(self) -> Iterator[Metric]:
        try:
            reading = self._record.read()
        except RecordsUnavailable:
            yield _record_up(is_up=False)
            return
        yield _record_up(is_up=True)
        yield from families(reading)


def exposition(instruments: Instruments, record: RecentReading, accept: str) -> tuple[bytes, str]:
    """The body of an answer, and its media type."""
    registry = CollectorRegistry()
    for collector in (*instruments.collectors(), RecordCollector(record)):
        registry.register(collector)
    encode, media_type = choose_encoder(accept)
    return encode(registry), media_type


def families(reading: Reading) -> Iterator[Metric]:
    """The record's numbers, as Prometheus gets them."""
    numbers = reading.numbers
    if numbers.beat_at is not None:
        silence_s = max(0.0, (numbers.moment - numbers.beat_at).total_seconds())
        yield _gauge(
            "gaitway_reconciler_silence_seconds",
            "Seconds since a reconciler reached the database.",
            silence_s,
        )
    yield _jobs(numbers.unfinished)
    yield from _queue(reading.wanted)
    yield _slots(reading.workers)
    yield from _ended(numbers.ended)
    yield from _gpus(numbers)
    for series in ALL:
        yield _tallied(series, [tally for tally in numbers.tallies if tally.series == series.name])


def _gauge(name: str, documentation: str, value: float) -> Metric:
    return GaugeMetricFamily(name, documentation, value=value)


def _record_up(*, is_up: bool) -> Metric:
    return _gauge("gaitway_record_up", "1 if PostgreSQL gave the numbers of the record.", float(is_up))


def _jobs(unfinished: Iterable[UnfinishedJobs]) -> Metric:
    family = GaugeMetricFamily(
        "gaitway_jobs", "Jobs that have not ended, by status.", labels=["status", "project"]
    )
    for row in unfinished:
        family.add_metric([row.status, row.project], row.number)
    return family


def _queue(wanted: Iterable[WantedSlots]) -> Iterator[Metric]:
    labels = ["accelerator", "gpus", "hosts"]
    waiting = GaugeMetricFamily("gaitway_queue_jobs", "Jobs that wait for a worker.", labels=labels)
    oldest = GaugeMetricFamily(
        "gaitway_queue_oldest_seconds",
        "Seconds for which the oldest of these jobs has waited.",
        labels=labels,
    )
    for slots in wanted:
        values = [slots.kind.accelerator, str(slots.kind.gpus), str(slots.kind.hosts)]
        waiting.add_metric(values, slots.queued)
        oldest.add_metric(values, slots.oldest_queued_s or 0.0)
    yield waiting
    yield oldest


def _slots(workers: Iterable[WorkerInfo]) -> Metric:
    family = GaugeMetricFamily(
        "gaitway_slots",
        "Workers by their device and what they do; each runs one job at a time.",
        labels=["device", "gpus", "state"],
    )
    number = Sums(
        (kind_of(worker.device), str(len(gpu_indices(worker.device))), _state(worker)) for worker in workers
    )
    for values, how_many in number.items():
        family.add_metric(values, how_many)
    return family


def _state(worker: WorkerInfo) -> str:
    if worker.state != "ready":
        return worker.state
    return "busy" if worker.jobs or worker.job else "idle"


def _ended(ended: Sequence[Ended]) -> Iterator[Metric]:
    jobs = CounterMetricFamily(
        "gaitway_jobs_ended", "Jobs that have ended.", labels=["status", "reason", "project"]
    )
    attempts = CounterMetricFamily(
        "gaitway_attempts_ended", "Attempts at jobs that have ended.", labels=["reason", "project"]
    )
    num_jobs, num_attempts = Sums[tuple[str, ...]](), Sums[tuple[str, ...]]()
    for row in ended:
        num_jobs[row.status, row.reason, row.project] += row.jobs
        num_attempts[row.reason, row.project] += row.attempts
    for values, number in num_jobs.items():
        if number:  # A job that waits again has ended no more than its attempt.
            jobs.add_metric(values, number)
    for values, number in num_attempts.items():
        if number:
            attempts.add_metric(values, number)
    yield jobs
    yield attempts


def _gpus(numbers: RecordNumbers) -> Iterator[Metric]:
    """A project that has ever run something is always there, so that `rate` sees its first job."""
    busy = GaugeMetricFamily("gaitway_busy_gpus", "GPUs whose workers have a job.", labels=["project"])
    gpu_seconds = CounterMetricFamily(
        "gaitway_gpu_seconds", "Seconds of attempts, times the GPUs that each had.", labels=["project"]
    )
    cpu_seconds = CounterMetricFamily(
        "gaitway_cpu_slot_seconds", "Seconds of attempts on workers without a GPU.", labels=["project"]
    )
    num_busy, gpu, cpu = (
        defaultdict[str, float](float),
        defaultdict[str, float](float),
        defaultdict[str, float](float),
    )
    for row in numbers.ended:
        gpu[row.project] += row.gpu_seconds
        cpu[row.project] += row.seconds if row.device != "gpu" else 0.0
    for attempt in numbers.running:
        seconds = _seconds(attempt, numbers)
        num_busy[attempt.project] += attempt.num_gpus
        gpu[attempt.project] += seconds * attempt.num_gpus
        cpu[attempt.project] += 0.0 if attempt.num_gpus else seconds
    for project in sorted(gpu.keys() | cpu.keys()):
        busy.add_metric([project], num_busy[project])
        gpu_seconds.add_metric([project], gpu[project])
        cpu_seconds.add_metric([project], cpu[project])
    yield busy
    yield gpu_seconds
    yield cpu_seconds


def _seconds(attempt: RunningAttempt, numbers: RecordNumbers) -> float:
    return max(0.0, (numbers.moment - attempt.started_at).total_seconds() - _MARGIN_S)


def _tallied(series: Series, tallies: Iterable[Tally]) -> Metric:
    if not series.bounds:
        counter = CounterMetricFamily(series.name, series.documentation, labels=series.labels)
        for tally in tallies:
            counter.add_metric(tally.labels, tally.total)
        return counter
    histogram = HistogramMetricFamily(series.name, series.documentation, labels=series.labels)
    for tally in tallies:
        if len(tally.buckets) == len(series.bounds) + 1:  # Otherwise, another version wrote it.
            histogram.add_metric(tally.labels, list(_cumulative(series, tally)), tally.total)
    return histogram


def _cumulative(series: Series, tally: Tally) -> Iterator[tuple[str, float]]:
    number = 0
    bounds = [*(str(float(bound)) for bound in series.bounds), "+Inf"]
    for bound, in_bucket in zip(bounds, tally.buckets, strict=True):
        number += in_bucket
        yield bound, number
