"""Trials that are trained together, and what becomes of them when one of them or their process ends early."""

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.cohort import shape_of
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.faults.bench import PROBE, SPEC, Bench, wait_until
from worker.host.device_lock import slot
from worker.host.processes import processes
from worker.supervision.cohort import Cohort

# The processes are real, and compile.
pytestmark = [pytest.mark.timeout(180), pytest.mark.usefixtures("compiled_quickly")]


@pytest.fixture
def bench(tmp_path: Path, job_store: PostgresJobStore) -> Bench:
    return Bench(tmp_path, job_store)


def jobs_of(bench: Bench, number: int) -> Sequence[Job]:
    """Trainings that last longer than any test, of several seeds."""
    said = {**SPEC, "checkpoints": {"every_steps": 12_800}, "video": None}
    return [bench.submit(**{**said, "seed": seed}) for seed in range(number)]


@contextmanager
def running(bench: Bench, jobs: Sequence[Job]) -> Iterator[Cohort]:
    """Inside the block, each has a checkpoint; after it, the cohort has ended."""
    claims = [bench.claim(job) for job in jobs]
    cohort = Cohort(claims, jobs[0].spec.environment, bench.settings, "cpu", ("slot",))
    thread = threading.Thread(target=cohort.run)
    thread.start()
    wait_until(lambda: all(num_checkpoints(bench, job) for job in jobs), 150)
    yield cohort
    thread.join(30)
    assert not thread.is_alive()
    assert list((bench.settings.data_dir / "spool").iterdir()) == []


def num_checkpoints(bench: Bench, job: Job) -> int:
    return sum(artifact.role == "checkpoint" for artifact in bench.store.get(job.id).artifacts)


def process_of_the_cohort() -> int:
    """The only child of ours that was given nothing but descriptors."""
    [found] = [
        pid
        for pid, _, _ in processes(Path("/proc"))
        if b"worker.training.cohort" in command_of(pid) and parent_of(pid) == os.getpid()
    ]
    return found


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def parent_of(pid: int) -> int:
    stat = Path(f"/proc/{pid}/stat").read_text()
    return int(stat.rpartition(")")[2].split()[1])


def test_one_is_cancelled_and_the_others_go_on_until_their_process_is_killed(bench: Bench) -> None:
    first, second, third = jobs_of(bench, 3)
    with running(bench, (first, second, third)):
        bench.cancel(second)
        wait_until(lambda: bench.store.get(second.id).status.is_final)
        had = num_checkpoints(bench, first)
        wait_until(lambda: num_checkpoints(bench, first) > had or bench.store.get(first.id).progress.step > 0)
        os.kill(process_of_the_cohort(), signal.SIGKILL)
    cancelled = bench.store.get(second.id)
    assert (cancelled.status, cancelled.reason) == (JobStatus.CANCELLED, Reason.USER_CANCELLED)
    assert cancelled.newest("policy") is not None
    for job in map(bench.store.get, (first.id, third.id)):
        assert (job.status, job.attempts[0].reason) == (JobStatus.QUEUED, Reason.COHORT_ENDED)
        assert job.attempts[0].details["trained_together"] == 3
        assert job.newest("checkpoint") is not None


@pytest.mark.slow  # The numbers are compiled again; a drain is one of a single training, too.
def test_a_drain_gives_all_of_them_back_with_what_they_have(bench: Bench) -> None:
    jobs = jobs_of(bench, 2)
    with running(bench, jobs) as cohort:
        cohort.draining.set()
    for job in (bench.store.get(job.id) for job in jobs):
        assert (job.status, job.attempts[0].reason) == (JobStatus.QUEUED, Reason.WORKER_DRAINED)
        assert job.newest("checkpoint") is not None


def test_jobs_that_do_not_fit_together_train_alone_and_lose_no_attempt(bench: Bench) -> None:
    jobs = [bench.submit(**{**SPEC, "seed": seed, "max_attempts": 1}) for seed in range(2)]
    too_large = (sys.executable, "-c", "raise MemoryError('RESOURCE_EXHAUSTED')")
    claims = [bench.claim(job) for job in jobs]
    Cohort(claims, jobs[0].spec.environment, bench.settings, "cpu", ("slot",), command=too_large).run()
    for job in (bench.store.get(job.id) for job in jobs):
        assert (job.status, job.attempts[0].reason) == (JobStatus.QUEUED, Reason.COHORT_ENDED)
        assert shape_of(job, "gpu") is None


def test_members_have_time_in_proportion_to_their_number(bench: Bench) -> None:
    jobs = [bench.submit(**{**SPEC, "seed": seed, "timeout_s": 0.5}) for seed in range(3)]
    until_all_have_left = "import os, sys; [os.read(int(descriptor), 1) for descriptor in sys.argv[1:]]"
    Cohort(
        [bench.claim(job) for job in jobs],
        jobs[0].spec.environment,
        bench.settings,
        "cpu",
        ("slot",),
        command=(sys.executable, "-c", until_all_have_left),
        member_command=(sys.executable, str(PROBE), "waits"),
    ).run()
    for job in (bench.store.get(job.id) for job in jobs):
        assert (job.status, job.reason) == (JobStatus.FAILED, Reason.TIMEOUT)
        assert job.message == "It took longer than timeout_s allows: 1.5 s. The work up to then is kept."


def test_a_device_that_another_process_holds_costs_no_job_an_attempt(bench: Bench) -> None:
    jobs = jobs_of(bench, 2)
    bench.settings = bench.settings.model_copy(update={"grace": bench.settings.heartbeat})
    with slot(bench.settings.data_dir.absolute() / "locks" / "slot.lock", 0.0):
        claims = [bench.claim(job) for job in jobs]
        Cohort(claims, jobs[0].spec.environment, bench.settings, "cpu", ("slot",)).run()
    for job in (bench.store.get(job.id) for job in jobs):
        assert (job.status, job.attempts[0].reason) == (JobStatus.QUEUED, Reason.DEVICE_HELD)
        assert job.lost_attempts == 0
