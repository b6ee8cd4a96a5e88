"""A worker without a package that a job needs leaves it to one that has it: real workers, real stores."""

import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from datetime import timedelta

import pytest
import redis

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.jobs.job import utc_now
from core.jobs.queue import queue_names
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.settings import WorkerSettings
from tests.faults.bench import wait_until
from tests.faults.outages import submitted
from tests.unit.worker.environments import environment

pytestmark = pytest.mark.extra


@contextmanager
def working(settings: WorkerSettings, name: str, behaviour: str, *lacking: str) -> Generator[None]:
    """A worker whose trainings all do the same, with a disk of its own."""
    own = settings.model_copy(update={"data_dir": settings.data_dir / name})
    command = [sys.executable, "-m", "tests.faults.probe_worker", behaviour, *lacking]
    with subprocess.Popen(command, env=environment(own, GAITWAY_DEVICE="cpu")) as process:
        try:
            yield
            process.send_signal(signal.SIGTERM)
            assert process.wait(30) == 0
        finally:
            process.kill()


@pytest.fixture
def queue(redis_client: redis.Redis) -> RQQueue:
    return RQQueue(redis_client)


def test_a_job_goes_to_the_worker_that_has_its_package(
    settings: WorkerSettings, job_store: PostgresJobStore, queue: RQQueue
) -> None:
    reconciler = Reconciler(job_store, queue, settings.lease)
    equipped = WorkerInfo(
        name="equipped",
        host="elsewhere",
        pid=1,
        device="cpu",
        queues=queue_names("cpu"),
        packages=("dm_control",),
        started_at=utc_now(),
        seen_at=utc_now(),
    )
    job_store.announce(equipped, timedelta(minutes=1))
    with ExitStack() as workers:
        workers.enter_context(working(settings, "lacking", "fails", "dm_control"))
        job = submitted(job_store, queue, environment="rodent")
        for _ in range(3):
            wait_until(lambda: not queue.contains(job.id, 1), 20)
            assert job_store.get(job.id) == job
            wait_until(lambda: reconciler.run_once() == 1)
        workers.enter_context(working(settings, "equipped", "succeeds"))

        def has_ended() -> bool:
            reconciler.run_once()
            return job_store.get(job.id).status.is_final

        wait_until(has_ended, 20)
    done = job_store.get(job.id)
    assert (done.status, len(done.attempts)) == (JobStatus.SUCCEEDED, 1)


def test_a_job_whose_package_no_worker_has_is_begun_and_fails(
    settings: WorkerSettings, job_store: PostgresJobStore, queue: RQQueue
) -> None:
    with working(settings, "lacking", "fails", "dm_control"):
        job = submitted(job_store, queue, environment="rodent")
        wait_until(lambda: job_store.get(job.id).status.is_final, 20)
    assert job_store.get(job.id).status == JobStatus.FAILED
