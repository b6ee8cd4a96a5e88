"""A training that takes memory without end is ended, and nobody else is."""

from pathlib import Path

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.faults.bench import Bench

_LIMIT = 2**28  # 0.25 GiB; the probe would go on to 4 GiB.


def test_a_training_without_bounds_ends_with_the_limit_in_its_message_and_is_tried_once_more(
    tmp_path: Path, job_store: PostgresJobStore
) -> None:
    bench = Bench(tmp_path, job_store)
    bench.settings = bench.settings.model_copy(update={"memory_limit": _LIMIT})
    job = bench.run("takes_memory", max_attempts=10)
    (first,) = job.attempts
    assert (job.status, first.reason) == (JobStatus.QUEUED, Reason.OUT_OF_HOST_MEMORY)
    assert first.message is not None
    assert "GAITWAY_MEMORY_LIMIT allows 0.2 GiB" in first.message
    # It has been looked at ten times a second.
    assert float(first.message.split()[3]) < 4
    bench.supervisor(job, "takes_memory").run()
    ended = bench.store.get(job.id)
    assert (ended.status, ended.reason) == (JobStatus.FAILED, Reason.OUT_OF_HOST_MEMORY)
    # The supervisor goes on to the next job.
    assert bench.run("succeeds").status == JobStatus.SUCCEEDED


def test_a_crash_of_native_code_is_told_from_a_kill(tmp_path: Path, job_store: PostgresJobStore) -> None:
    bench = Bench(tmp_path, job_store)
    crashed, killed = bench.run("crashes_natively").attempts[0], bench.run("is_killed").attempts[0]
    assert (crashed.reason, killed.reason) == (Reason.NATIVE_CRASH, Reason.TRAINING_KILLED)
