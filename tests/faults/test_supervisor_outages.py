"""A supervisor whose stores are away: training goes on, nothing is lost or counted, and a drain ends."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from core.errors import RecordsUnavailable, StorageUnavailable
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.retry import retry_while_unavailable
from tests.extra import extra
from tests.faults.bench import Bench, wait_until
from tests.faults.outages import Outages, Watch, pooled
from worker.supervision import supervisor as supervisor_module
from worker.supervision.spool import record_left

# Long enough for a test on a busy machine to begin its heartbeat.
LEASE = timedelta(seconds=2)
# Of PostgreSQL, and of the object store.
OF_RECORDS, OF_OBJECTS = ("silence", "absence"), ("silent objects", "absent objects")


class Disturbed(Bench):
    """A bench whose stores can be taken away."""

    def __init__(self, data_dir: Path, postgres: Outages, patch: pytest.MonkeyPatch) -> None:
        self._url = postgres.fresh()
        super().__init__(data_dir, store := pooled(self._url, 10))
        self.close = store.close
        self.settings = self.settings.model_copy(
            update={"lease": LEASE, "heartbeat": LEASE / 5, "grace": timedelta(seconds=1)}
        )
        self._postgres, self._patch = postgres, patch

    @contextmanager
    def outage(self, name: str) -> Iterator[None]:
        with getattr(self._postgres, name)() if name in OF_RECORDS else self._no_objects(name):
            yield

    @contextmanager
    def watched(self) -> Iterator[JobStore]:
        """By a reconciler; the record, as another process reaches it."""
        store = pooled(self._url)
        with Watch(store, self.queue, LEASE):
            yield store
        store.close()

    @contextmanager
    def working(self, job: Job, behaviour: str) -> Iterator[None]:
        """Its supervisor in a thread; the attempt has ended after the block."""
        thread = threading.Thread(target=self.supervisor(job, behaviour).run)
        thread.start()
        try:
            wait_until(lambda: self.store.get(job.id).status == JobStatus.RUNNING)
            yield
        finally:
            thread.join(30)
        assert not thread.is_alive()

    def training_has_ended(self) -> bool:
        """Whether the device is free again."""
        return not list((self.settings.data_dir / "locks").iterdir())

    @contextmanager
    def _no_objects(self, how: str) -> Iterator[None]:
        back = threading.Event()
        put_stream = self.objects.put_stream

        def away(*put: Any, **named: Any) -> None:
            if how == "silent objects":
                back.wait(20)
            if not back.is_set():
                raise StorageUnavailable("The test switched it off.")
            put_stream(*put, **named)

        self._patch.setattr(self.objects, "put_stream", away)
        try:
            yield
        finally:
            back.set()


def status_of(store: JobStore, job: Job) -> JobStatus | None:
    """None as long as it cannot be reached."""
    try:
        return store.get(job.id).status
    except RecordsUnavailable:
        return None


@pytest.fixture
def bench(tmp_path: Path, postgres: Outages, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disturbed]:
    monkeypatch.setenv("PROBE_WAITS_FOR", str(tmp_path / "go"))
    bench = Disturbed(tmp_path, postgres, monkeypatch)
    yield bench
    wait_until(lambda: "outbox" not in {thread.name for thread in threading.enumerate()})
    bench.close()


@pytest.mark.parametrize("name", ["silence", "absent objects", *extra("absence", "silent objects")])
def test_training_goes_on_and_its_results_are_stored_afterwards(name: str, bench: Disturbed) -> None:
    job = bench.submit(max_attempts=1)
    with bench.watched(), bench.working(job, "is_filmed"), bench.outage(name):
        (bench.settings.data_dir / "go").touch()
        wait_until(bench.training_has_ended)
        time.sleep(1.5 * LEASE.total_seconds())  # Nobody gets the job meanwhile.
    done = bench.store.get(job.id)
    assert (done.status, len(done.attempts)) == (JobStatus.SUCCEEDED, 1)
    video = done.newest("video")
    assert video is not None
    assert bench.objects.get(video.key) == b"film"
    assert [row.data["step"] for row in bench.feed(job, "events", "metrics")] == [10, 20]


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "_LAST_S", 0.5)


@pytest.mark.extra
@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("name", OF_OBJECTS)
@pytest.mark.parametrize("behaviour", ["waits", "is_filmed"])
def test_a_drain_without_the_object_store_gives_the_job_back_within_the_grace_time(
    behaviour: str, name: str, bench: Disturbed
) -> None:
    job = bench.submit(max_attempts=1)
    supervisor = bench.supervisor(job, behaviour)
    with bench.outage(name):
        thread = threading.Thread(target=supervisor.run)
        thread.start()
        wait_until(lambda: bench.store.get(job.id).status == JobStatus.RUNNING)
        (bench.settings.data_dir / "go").touch()
        if behaviour == "is_filmed":  # It has finished, and waits for the store.
            wait_until(bench.training_has_ended)
        supervisor.draining.set()
        told = time.monotonic()
        thread.join(20)
        assert not thread.is_alive()
        assert time.monotonic() - told < 4  # Of a grace time of 1 s.
        given_back = bench.store.get(job.id)
    (attempt,) = given_back.attempts
    assert (given_back.status, attempt.reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
    assert attempt.message is not None
    assert "before everything was stored" in attempt.message


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("name", ["silence", *extra("absence")])
def test_a_drain_without_postgresql_is_told_by_the_next_worker_and_costs_no_attempt(
    name: str, bench: Disturbed
) -> None:
    job = bench.submit(max_attempts=1)
    drain_without_postgresql(name, job, bench)
    retry_while_unavailable(partial(record_left, bench.settings.data_dir, bench.store, bench.objects), 10)
    told = bench.store.get(job.id)
    assert (told.status, [a.reason for a in told.attempts]) == (JobStatus.QUEUED, [Reason.WORKER_DRAINED])
    assert told.newest("checkpoint", 10) is not None
    assert list((bench.settings.data_dir / "left").iterdir()) == []


@pytest.mark.extra
@pytest.mark.usefixtures("hurried")
def test_a_drain_without_postgresql_that_nobody_tells_leaves_the_job_to_the_end_of_its_lease(
    bench: Disturbed,
) -> None:
    job = bench.submit()
    drain_without_postgresql("absence", job, bench)
    with bench.watched() as store:
        wait_until(lambda: status_of(store, job) == JobStatus.QUEUED)
        lost = store.get(job.id)
        record_left(bench.settings.data_dir, store, bench.objects)  # A worker that comes too late.
        assert store.get(job.id) == lost
    assert (lost.status, [a.reason for a in lost.attempts]) == (JobStatus.QUEUED, [Reason.WORKER_LOST])
    assert lost.newest("checkpoint", 10) is not None
    assert list((bench.settings.data_dir / "left").iterdir()) == []


def drain_without_postgresql(name: str, job: Job, bench: Disturbed) -> None:
    """The job has a checkpoint; its supervisor has gone."""
    supervisor = bench.supervisor(job, "waits")
    thread = threading.Thread(target=supervisor.run)
    thread.start()
    wait_until(lambda: bench.store.get(job.id).newest("checkpoint") is not None)
    with bench.outage(name):
        supervisor.draining.set()
        told = time.monotonic()
        thread.join(20)
        assert not thread.is_alive()
        # A grace time of 1 s, and calls that take 2 s each to give up.
        assert time.monotonic() - told < 8
