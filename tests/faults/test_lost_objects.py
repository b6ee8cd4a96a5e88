"""The object store is silent: what has nothing to do with it goes on."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.settings import WorkerSettings
from gaitway.service.embedded.weed import Weed
from tests.contract.recording import Database, watch
from tests.faults.bench import wait_until
from tests.faults.outages import submitted
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.unit.worker.environments import environment

pytestmark = pytest.mark.extra


@contextmanager
def silence(weed: Weed) -> Iterator[None]:
    """It takes connections, and says nothing."""
    pid = weed.process.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def held(store: PostgresJobStore, lease: timedelta) -> Claim:
    job = submitted(store, MemoryJobQueue())
    claim = claim_attempt(
        job.id, 1, "w", store=store, objects=MemoryObjectStore(), lease=lease, secret=new_secret()
    )
    assert claim is not None
    return claim


def test_a_reconciler_whose_chores_wait_for_the_object_store_takes_jobs_back_in_time(
    settings: WorkerSettings, job_store: PostgresJobStore, weed: Weed, database: Database, tmp_path: Path
) -> None:
    alive = tmp_path / "alive"
    variables = environment(settings, GAITWAY_RECONCILE_EVERY="0.2", GAITWAY_ALIVE_FILE=str(alive))
    command = [sys.executable, "-m", "worker.reconciler"]
    with subprocess.Popen(command, env=variables, stdout=subprocess.DEVNULL) as reconciler:
        try:
            wait_until(alive.exists)
            watch(job_store, database)
            with silence(weed):
                # Its feed becomes an object at its end.
                held(job_store, timedelta(minutes=1)).end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.")
                dead = held(job_store, timedelta(milliseconds=1))
                # A call to the object store gives up after half a minute.
                wait_until(lambda: job_store.get(dead.job_id).status == JobStatus.QUEUED, 20)
        finally:
            reconciler.kill()
    assert [attempt.reason for attempt in job_store.get(dead.job_id).attempts] == [Reason.WORKER_LOST]
