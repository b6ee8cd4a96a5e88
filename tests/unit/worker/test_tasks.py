"""What a work-horse does with a dispatch that it cannot take on: real processes, real stores."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager

import pytest
import redis

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.submission import submit
from core.reasons import Reason
from core.settings import WorkerSettings
from tests.unit.worker.environments import environment

_RUN = """
import sys
from core.telemetry import configure_logging
from worker.tasks import run_attempt
configure_logging("worker")
run_attempt(sys.argv[1], int(sys.argv[2]))
"""


@pytest.fixture
def job(job_store: PostgresJobStore, redis_client: redis.Redis) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "inverted_pendulum"})
    return submit(spec, store=job_store, queue=RQQueue(redis_client))


@contextmanager
def dispatched(
    job: Job, attempt: int, settings: WorkerSettings, program: str = _RUN, **variables: str
) -> Generator["subprocess.Popen[str]"]:
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    with subprocess.Popen(
        [sys.executable, "-c", program, job.id, str(attempt)],
        env=environment(settings, **variables),
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.extra
def test_a_gpu_that_has_gone_costs_the_job_nothing_and_a_drain_ends_the_pause(
    job: Job, settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    with dispatched(job, 1, settings, GAITWAY_DEVICE="gpu:99") as process:
        assert process.stdout is not None
        line = json.loads(process.stdout.readline())
        process.send_signal(signal.SIGTERM)
        told = time.monotonic()
        assert process.wait(10) == 0
        assert time.monotonic() - told < 3  # Of a pause of 5 s.
    assert line["event"] == "no_job_begun"
    assert "GAITWAY_DEVICE=gpu:99" in line["detail"]
    assert job_store.get(job.id) == job


def test_the_spools_of_killed_attempts_go_before_the_disk_is_looked_at(
    job: Job, settings: WorkerSettings, job_store: PostgresJobStore
) -> None:
    job_store.save(job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", job_store.now()))
    left = settings.data_dir / "spool" / "job.1"
    left.mkdir(parents=True)
    (left / "checkpoint").touch()
    with dispatched(job, 1, settings) as process:
        log, _ = process.communicate(timeout=30)
    assert json.loads(log)["event"] == "dispatch_ignored"
    assert not left.exists()
