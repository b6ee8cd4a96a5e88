"""A machine's GPUs as one pool: a real fleet on four pretended GPUs, jobs of one, two and four."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest
import redis

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.devices import device_name, gpu_indices
from core.jobs.job import Job
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo, what_it_waits_for
from core.reasons import Reason
from core.settings import WorkerSettings
from tests.faults.bench import wait_until
from tests.faults.outages import submitted
from tests.unit.worker.environments import environment


class Machine:
    """The fleet, the record, and a reconciler that looks while the test waits.

    A job runs until it is let go. folder: what lets them go.
    """

    def __init__(
        self,
        store: PostgresJobStore,
        client: redis.Redis,
        settings: WorkerSettings,
        folder: Path,
        **variables: str,
    ) -> None:
        self.store, self.queue, self._folder = store, RQQueue(client), folder
        self._reconciler = Reconciler(store, self.queue, settings.lease)
        folder.mkdir()
        outer = environment(settings, PROBE_WAITS_FOR=str(folder), **variables)
        self.fleet = subprocess.Popen([sys.executable, "-m", "tests.faults.pretended_pool"], env=outer)

    def close(self) -> None:
        self.fleet.send_signal(signal.SIGTERM)
        self.fleet.wait(60)

    def wait(self, condition: Callable[[], bool], timeout_s: float = 60) -> None:
        def looked() -> bool:
            self._reconciler.run_once()
            return condition()

        wait_until(looked, timeout_s)

    def submit(self, gpus: int) -> Job:
        return submitted(self.store, self.queue, resources={"gpus": gpus})

    def submit_sharing(self, gpu_memory_gib: float) -> Job:
        resources = {"share_gpu": True, "gpu_memory_gib": gpu_memory_gib}
        return submitted(self.store, self.queue, resources=resources)

    def let_go(self, *jobs: Job) -> None:
        for job in jobs:
            (self._folder / job.id).touch()

    def statuses(self, *jobs: Job) -> list[JobStatus]:
        return [self.store.get(job.id).status for job in jobs]

    def wait_for(self, status: JobStatus, *jobs: Job) -> None:
        self.wait(lambda: self.statuses(*jobs) == [status] * len(jobs))

    def num_attempts(self, job: Job) -> int:
        return len(self.store.get(job.id).attempts)

    def gpus(self, job: Job) -> set[int]:
        """Those that the job's training sees, once it has said so."""
        seen = list[str]()

        def has_said() -> bool:
            seen[:] = (self.store.get(job.id).attempts[-1].device or "probe").split(",")
            return seen != ["probe"]

        wait_until(has_said)
        return set(map(int, seen))

    def training(self, job: Job) -> psutil.Process:
        """The process of its last attempt."""
        spool = f"{job.id}.{self.num_attempts(job)}"
        (found,) = [
            process
            for process in psutil.Process(self.fleet.pid).children(recursive=True)
            if any(spool in word for word in process.cmdline())
        ]
        return found

    def let_fail_together(self) -> None:
        """From now on, no GPUs of the machine work together."""
        (self._folder / "fail-together").touch()

    def worker_of(self, gpu: int) -> WorkerInfo:
        """The newest."""
        found = [worker for worker in self.store.workers() if gpu_indices(worker.device) == [gpu]]
        return max(found, key=lambda worker: worker.started_at)

    def states(self) -> list[str]:
        return sorted(worker.state for worker in self.store.workers())


@pytest.fixture
def machine(
    settings: WorkerSettings, job_store: PostgresJobStore, redis_client: redis.Redis, tmp_path: Path
) -> Iterator[Machine]:
    machine = Machine(job_store, redis_client, settings, tmp_path / "go", GAITWAY_SEATS="1")
    with closing(machine):
        machine.wait(lambda: machine.states() == ["ready"] * 4)
        yield machine


@pytest.fixture
def shared(
    settings: WorkerSettings, job_store: PostgresJobStore, redis_client: redis.Redis, tmp_path: Path
) -> Iterator[Machine]:
    """Two GPUs of 16 GiB, each with two seats."""
    machine = Machine(job_store, redis_client, settings, tmp_path / "go", GAITWAY_POOL="gpu:0-1")
    with closing(machine):
        machine.wait(lambda: machine.states() == ["ready"] * 4)
        yield machine


def test_small_jobs_do_not_starve_one_of_all_gpus(machine: Machine) -> None:
    two, one = machine.submit(2), machine.submit(1)
    machine.wait_for(JobStatus.RUNNING, two, one)
    machine.wait(lambda: machine.states() == ["lent", "ready", "ready", "ready"])
    four, small = machine.submit(4), machine.submit(1)
    # A GPU is free for the small one, which nobody knows to end soon.
    machine.wait(lambda: "kept" in machine.states())
    (kept,) = [worker for worker in machine.store.workers() if worker.state == "kept"]
    assert kept.problem == f"The job {four.id} comes first, and needs 4 GPUs; 1 is free here."
    machine.let_go(two, one)
    machine.wait_for(JobStatus.RUNNING, four)
    assert machine.gpus(four) == {0, 1, 2, 3}
    assert machine.statuses(small) == [JobStatus.QUEUED]
    # A worker whose GPU is lent ends, and another one comes: the job has nothing to do with it.
    machine.wait(lambda: machine.states() == ["lent", "lent", "lent", "ready"])
    lent = next(worker for worker in machine.store.workers() if worker.state == "lent")
    assert lent.problem == f"The job {four.id} has its GPU: it runs on gpu:0,1,2,3 of this machine."
    os.kill(lent.pid, signal.SIGKILL)
    machine.wait(lambda: lent.pid != machine.worker_of(gpu_indices(lent.device)[0]).pid)
    machine.let_go(four)
    machine.wait_for(JobStatus.RUNNING, small)
    assert [attempt.reason for attempt in machine.store.get(four.id).attempts] == [Reason.COMPLETED]


def test_gpus_that_fail_together_are_given_to_jobs_of_one_alone(machine: Machine) -> None:
    two = machine.submit(2)
    machine.wait_for(JobStatus.RUNNING, two)
    given = device_name(sorted(machine.gpus(two)))
    machine.let_fail_together()
    machine.training(two).send_signal(signal.SIGSEGV)
    machine.wait(lambda: machine.num_attempts(two) == 1 and machine.statuses(two) == [JobStatus.QUEUED])
    (failed,) = machine.store.get(two.id).attempts
    assert failed.reason == Reason.DEVICE_FAILED
    said = f"A test of the device {given} failed (status 1): NCCL error."
    assert (failed.message or "").endswith(said)
    only_one = f"It takes only jobs of one GPU for an hour. {said}"
    machine.wait(lambda: [worker.problem for worker in machine.store.workers()] == [only_one] * 4)
    waits = what_it_waits_for(machine.store.get(two.id), machine.store.workers())
    assert (
        waits == "No worker has exactly 2 GPUs: the workers here have 4 GPUs of one host that fail together."
    )
    ones = [machine.submit(1) for _ in range(4)]
    machine.wait_for(JobStatus.RUNNING, *ones)
    machine.let_go(*ones)
    machine.wait_for(JobStatus.SUCCEEDED, *ones)
    assert machine.num_attempts(two) == 1


@pytest.mark.extra
def test_a_job_whose_worker_or_training_is_killed_leaves_no_gpu_behind(machine: Machine) -> None:
    two, *ones = machine.submit(2), machine.submit(1), machine.submit(1)
    machine.wait_for(JobStatus.RUNNING, two, *ones)
    assert sorted(gpu for job in (two, *ones) for gpu in machine.gpus(job)) == [0, 1, 2, 3]
    # Its worker: the attempt drains, and a worker of the machine goes on with it.
    owner = machine.store.get(two.id).attempts[-1].worker
    (pid,) = [worker.pid for worker in machine.store.workers() if worker.name == owner]
    os.kill(pid, signal.SIGKILL)
    machine.wait(lambda: machine.num_attempts(two) == 2)
    # Its training, once it runs.
    assert len(machine.gpus(two)) == 2
    machine.training(two).kill()
    machine.wait(lambda: machine.num_attempts(two) == 3)
    machine.wait_for(JobStatus.RUNNING, two, *ones)
    assert sorted(gpu for job in (two, *ones) for gpu in machine.gpus(job)) == [0, 1, 2, 3]
    four = machine.submit(4)
    machine.let_go(two, *ones, four)
    machine.wait_for(JobStatus.SUCCEEDED, two, *ones, four)


def test_two_jobs_share_a_gpu_and_others_wait_for_their_part_or_for_all_of_it(shared: Machine) -> None:
    one, two = shared.submit_sharing(6), shared.submit_sharing(8)
    shared.wait_for(JobStatus.RUNNING, one, two)
    # The second joins the first, so that a GPU stays free for the one that needs a whole one.
    alone = shared.submit(1)
    shared.wait_for(JobStatus.RUNNING, alone)
    (gpu,) = shared.gpus(one)
    assert (shared.gpus(two), shared.gpus(alone)) == ({gpu}, {1 - gpu})
    assert [shared.store.get(job.id).attempts[-1].gpu_part for job in (one, two, alone)] == [
        6 / 16,
        0.5,
        None,
    ]
    third, both = shared.submit_sharing(4), shared.submit(2)
    shared.wait(lambda: shared.states().count("lent") == 1)  # The other seat of the one that has a GPU alone.
    assert shared.statuses(third, both) == [JobStatus.QUEUED] * 2
    # The training of one is killed. The third joins the other, which hears nothing of it.
    (training,) = [
        process
        for process in psutil.Process(shared.fleet.pid).children(recursive=True)
        if any(f"{one.id}.1" in word for word in process.cmdline())
    ]
    training.kill()
    shared.wait_for(JobStatus.RUNNING, third)
    assert (shared.gpus(third), shared.num_attempts(two)) == ({gpu}, 1)
    shared.let_go(third)
    shared.wait_for(JobStatus.RUNNING, one)
    assert (shared.gpus(one), shared.num_attempts(one)) == ({gpu}, 2)
    # Whole GPUs are free only when nobody has a part of them.
    shared.let_go(one, alone)
    shared.wait_for(JobStatus.SUCCEEDED, one, alone, third)
    assert shared.statuses(two, both) == [JobStatus.RUNNING, JobStatus.QUEUED]
    shared.let_go(two)
    shared.wait_for(JobStatus.RUNNING, both)
    assert shared.gpus(both) == {0, 1}
