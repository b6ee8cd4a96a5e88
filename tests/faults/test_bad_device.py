"""A device that fails is set aside, and its job tries elsewhere: real workers, and a file for the device."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import redis

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.jobs.job import Job
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo, what_it_waits_for
from core.reasons import Reason
from core.settings import WorkerSettings
from tests.faults.bench import Bench, wait_until
from tests.faults.outages import submitted
from tests.unit.worker.environments import environment

pytestmark = pytest.mark.extra

_SAID = "A test of the device cpu failed (status 1): gpu:0 has fallen off the bus."


class Fleet:
    """The record, a reconciler that looks while the test waits, and workers that share nothing else."""

    def __init__(self, store: PostgresJobStore, queue: RQQueue, settings: WorkerSettings) -> None:
        self.store, self.queue, self.settings = store, queue, settings
        self.reconciler = Reconciler(store, queue, settings.lease)
        self.processes = ExitStack()

    def start(self, name: str, behaviour: str, device: Path) -> "subprocess.Popen[bytes]":
        own = self.settings.model_copy(update={"data_dir": self.settings.data_dir / name})
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.faults.bad_device_worker", behaviour, str(device)],
            env=environment(own, PROBE_DEVICE_WORKS=str(device), GAITWAY_DEVICE="cpu"),
        )
        self.processes.callback(_end, process)
        return process

    def submit(self) -> Job:
        return submitted(self.store, self.queue)

    def wait_for(self, job: Job, status: JobStatus) -> Job:
        def has_come() -> bool:
            self.reconciler.run_once()
            return self.store.get(job.id).status == status

        wait_until(has_come, 20)
        return self.store.get(job.id)

    def wait_for_states(self, *states: str) -> list[WorkerInfo]:
        """Of all workers, in the order of their names' states."""
        wait_until(lambda: sorted(worker.state for worker in self.store.workers()) == sorted(states), 20)
        return sorted(self.store.workers(), key=lambda worker: worker.state)


def _end(process: "subprocess.Popen[bytes]") -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(10)
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def fleet(
    settings: WorkerSettings, job_store: PostgresJobStore, redis_client: redis.Redis
) -> Iterator[Fleet]:
    fleet = Fleet(job_store, RQQueue(redis_client), settings)
    with fleet.processes:
        yield fleet


@pytest.fixture
def device(tmp_path: Path) -> Path:
    """It works while this file is there."""
    file = tmp_path / "works"
    file.touch()
    return file


def test_a_device_that_fails_its_first_test_takes_no_job_until_it_works(fleet: Fleet, device: Path) -> None:
    device.unlink()
    fleet.start("bad", "succeeds", device)
    (bad,) = fleet.wait_for_states("device_failed")
    assert bad.problem == _SAID
    job = fleet.submit()
    told = what_it_waits_for(job, fleet.store.workers())
    assert told == f"The device of each suitable worker was set aside: {bad.name}: {_SAID}"
    assert fleet.queue.contains(job.id, 1)
    device.touch()
    done = fleet.wait_for(job, JobStatus.SUCCEEDED)
    assert [attempt.worker for attempt in done.attempts] == [bad.name]
    (bad,) = fleet.wait_for_states("ready")
    assert bad.problem is None


def test_a_card_that_breaks_under_a_job_is_set_aside_and_the_job_goes_on_elsewhere(
    fleet: Fleet, device: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.touch()
    bad = fleet.start("bad", "breaks_its_device", device)
    fleet.wait_for_states("ready")
    job = fleet.submit()
    fleet.wait_for_states("device_failed")
    fleet.start("good", "succeeds", other)
    done = fleet.wait_for(job, JobStatus.SUCCEEDED)
    first, second = done.attempts
    assert (first.reason, second.reason) == (Reason.DEVICE_FAILED, Reason.COMPLETED)
    assert first.message == (
        "Native code of the training process crashed (SIGSEGV); its log may show where. "
        f"It resumes from its last checkpoint. {_SAID}"
    )
    assert done.lost_attempts == 0
    fleet.wait_for_states("device_failed", "ready")
    bad.send_signal(signal.SIGTERM)
    assert bad.wait(10) == 0
    fleet.wait_for_states("ready")


def test_a_crash_on_a_device_that_works_is_the_jobs_own(tmp_path: Path, job_store: PostgresJobStore) -> None:
    bench = Bench(tmp_path, job_store)
    job = bench.submit()
    supervisor = bench.supervisor(job, "crashes_natively")
    supervisor.device_test = ("/bin/true",)
    supervisor.run()
    found = bench.store.get(job.id)
    assert (found.status, found.attempts[0].reason) == (JobStatus.QUEUED, Reason.NATIVE_CRASH)
    assert not list(tmp_path.glob("devices/*"))
