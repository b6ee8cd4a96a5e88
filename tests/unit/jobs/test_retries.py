"""What follows an attempt that failed: another one after a pause, or none."""

from collections.abc import Iterator
from datetime import timedelta

import pytest
from sqlalchemy import text

from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import PAUSES
from core.jobs.job import Job
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.in_memory import Dispatch, MemoryJobQueue, MemoryObjectStore
from tests.unit.jobs.playing import LEASE, PlayedWorker


class Service:
    """The record, whose clock tests move, a reconciler, and a worker whose attempts fail."""

    def __init__(self, database_url: str) -> None:
        self.engine = connect_postgres(database_url)
        self.store, self.queue = PostgresJobStore(self.engine), MemoryJobQueue()
        self.reconciler = Reconciler(self.store, self.queue, LEASE)
        self.worker = PlayedWorker(self.store, MemoryObjectStore())

    def fail(self, job: Job, reason: Reason, times: int = 1) -> Job:
        for _ in range(times):
            job = self.worker.begin(job).give_back(reason, "It failed.")
        return job

    def dispatched(self) -> list[Dispatch]:
        """After two looks: at the second, the queue has forgotten what it does not know."""
        for _ in range(2):
            self.reconciler.run_once()
        return list(self.queue.waiting())

    def set_clock(self, seconds: float) -> None:
        """To what waits, as if the database's clock had been set so much further."""
        with self.engine.begin() as connection:
            shifted = text("UPDATE jobs SET not_before = not_before - :s * interval '1 second'")
            connection.execute(shifted, {"s": seconds})


@pytest.fixture
def service(database_url: str) -> Iterator[Service]:
    service = Service(database_url)
    yield service
    service.engine.dispose()


def test_the_pause_after_each_failure_is_longer(service: Service) -> None:
    job, pauses = service.worker.submit(max_attempts=10), list[timedelta]()
    for _ in range(6):
        job = service.fail(job, Reason.TRAINING_KILLED)
        assert job.not_before is not None
        assert job.attempts[-1].ended_at is not None
        pauses.append(job.not_before - job.attempts[-1].ended_at)
    assert pauses == [*PAUSES, PAUSES[-1], PAUSES[-1]]
    assert service.store.get(job.id).not_before == job.not_before


def test_a_job_is_dispatched_when_its_pause_is_over_and_not_before(service: Service) -> None:
    job = service.fail(service.worker.submit(), Reason.NATIVE_CRASH, times=2)  # 4 s.
    assert service.dispatched() == []
    assert service.store.waiting() == service.store.undispatched() == []
    service.set_clock(4)
    assert service.dispatched() == [Dispatch(job.id, 3)]
    assert service.store.get(service.worker.begin(job).job_id).not_before is None


def test_a_pause_does_not_outlast_a_clock_that_is_set_back(service: Service) -> None:
    job = service.fail(service.worker.submit(), Reason.NATIVE_CRASH)
    service.set_clock(-7200)
    assert service.dispatched() == [Dispatch(job.id, 2)]


@pytest.mark.parametrize("reason", [Reason.WORKER_LOST, Reason.WORKER_DRAINED])
def test_who_lost_its_worker_does_not_wait(service: Service, reason: Reason) -> None:
    job = service.fail(service.worker.submit(), Reason.TRAINING_KILLED)
    job = service.fail(job, reason)
    assert job.not_before is None
    assert service.dispatched() == [Dispatch(job.id, 3)]


def test_a_job_that_waits_can_be_cancelled(service: Service) -> None:
    job = service.fail(service.worker.submit(), Reason.TRAINING_KILLED)
    ended = job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "Cancelled.", service.store.now())
    service.store.save(ended)
    assert service.store.get(job.id).not_before is None


@pytest.mark.parametrize(("reason", "most"), [(Reason.OUT_OF_HOST_MEMORY, 2), (Reason.DEVICE_FAILED, 3)])
def test_what_ends_so_again_and_again_is_the_jobs_own_fault(
    service: Service, reason: Reason, most: int
) -> None:
    job = service.fail(service.worker.submit(max_attempts=100), reason, times=most - 1)
    assert job.status == JobStatus.QUEUED
    job = service.fail(job, reason)
    assert (job.status, job.reason) == (JobStatus.FAILED, reason)
    assert job.message == f"It failed. {most} attempts ended like this; there is no further one."


def test_a_bad_card_costs_no_attempt(service: Service) -> None:
    job = service.fail(service.worker.submit(max_attempts=1), Reason.DEVICE_FAILED, times=2)
    assert (job.status, job.lost_attempts) == (JobStatus.QUEUED, 0)
