"""What a work-horse does with a dispatch that it cannot take on: real processes, real stores."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from datetime import timedelta
from functools import partial
from typing import Any

import pytest
import redis

from core.adapters.memory.objects import MemoryObjectStore
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.errors import RecordsUnavailable
from core.jobs.attempts import claim_attempt
from core.jobs.job import Job
from core.jobs.spec import JOB_SPEC
from core.jobs.submission import submit
from core.settings import WorkerSettings
from tests.unit.worker.environments import environment
from worker import tasks

_RUN = """
import sys
from core.telemetry import configure_logging
from worker.tasks import run_attempt
configure_logging("worker")
run_attempt(sys.argv[1], int(sys.argv[2]))
"""

# Instead of a run it says how many jobs would train together.
_TAKE = """
import sys
from types import SimpleNamespace
from worker import tasks
tasks.device_of = lambda wanted: wanted
tasks.slot_names = lambda device, pid: (device,)
tasks.Supervisor = lambda *_, **__: SimpleNamespace(run=lambda: print("took 1"))
tasks.Cohort = lambda claims, *_, **__: SimpleNamespace(run=lambda: print("took", len(claims)))
tasks.run_attempt(sys.argv[1], int(sys.argv[2]))
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
    job: Job, settings: WorkerSettings
) -> None:
    left = settings.data_dir / "spool" / "job.1"
    left.mkdir(parents=True)
    (left / "checkpoint").touch()
    with dispatched(job, 2, settings) as process:  # Of an attempt that is not due.
        log, _ = process.communicate(timeout=30)
    assert json.loads(log)["event"] == "dispatch_ignored"
    assert not left.exists()


@pytest.mark.parametrize(
    ("variables", "number"),
    [
        ({"GAITWAY_DEVICE": "cpu"}, 1),
        ({"GAITWAY_DEVICE": "gpu:0"}, 16),
        ({"GAITWAY_DEVICE": "gpu:0", "GAITWAY_MEMORY_LIMIT": "3.5GiB"}, 3),
        ({"GAITWAY_DEVICE": "cpu", "GAITWAY_COHORT": "4"}, 4),
    ],
    ids=["cpu", "gpu", "gpu of a small machine", "cpu that is told to"],
)
def test_a_worker_takes_the_trials_that_train_together_on_its_device(
    variables: dict[str, str],
    number: int,
    settings: WorkerSettings,
    job_store: PostgresJobStore,
    redis_client: redis.Redis,
) -> None:
    document = {"kind": "train", "environment": "ant", "labels": {"sweep": "s"}}
    first, *others = (
        submit(
            JOB_SPEC.validate_python({**document, "seed": seed}),
            store=job_store,
            queue=RQQueue(redis_client),
        )
        for seed in range(20)
    )
    given = {"GAITWAY_MEMORY_LIMIT": "64GiB", **variables}
    with dispatched(first, 1, settings, _TAKE, **given) as process:
        said, _ = process.communicate(timeout=30)
    assert said.splitlines()[-1] == f"took {number}"
    held = [job_store.get(one.id).status.is_held for one in (first, *others)]
    assert held == [True] * number + [False] * (20 - number)


# Each claim takes longer than half a lease, and says at the end whether the leases still hold.
_TAKE_SLOWLY = """
import sys, time
from types import SimpleNamespace
from sqlalchemy import text
from worker import tasks
claim = tasks.claim_attempt
tasks.claim_attempt = lambda *a, **k: (time.sleep(0.7), claim(*a, **k))[1]
tasks.device_of = lambda wanted: wanted
tasks.slot_names = lambda device, pid: (device,)
def run(claims):
    with claims[0].store._engine.connect() as connection:
        held = "SELECT count(*) FROM jobs WHERE lease_until > clock_timestamp()"
        print("took", len(claims), "holds", connection.execute(text(held)).scalar_one())
tasks.Cohort = lambda claims, *_, **__: SimpleNamespace(run=lambda: run(claims))
tasks.run_attempt(sys.argv[1], int(sys.argv[2]))
"""


def trials(store: PostgresJobStore, client: redis.Redis, number: int, **said: Any) -> list[Job]:
    document = {"kind": "train", "environment": "ant", "labels": {"sweep": "s"}, **said}
    specs = [JOB_SPEC.validate_python({**document, "seed": seed}) for seed in range(number)]
    return [submit(spec, store=store, queue=RQQueue(client)) for spec in specs]


def test_the_leases_are_kept_while_companions_are_claimed(
    settings: WorkerSettings, job_store: PostgresJobStore, redis_client: redis.Redis
) -> None:
    """M1: fifteen claims over a slow network outlasted the first lease."""
    first, *_ = trials(job_store, redis_client, 4)
    given = {"GAITWAY_DEVICE": "cpu", "GAITWAY_COHORT": "4", "GAITWAY_MEMORY_LIMIT": "64GiB"}
    beats = {"GAITWAY_LEASE": "1.2", "GAITWAY_HEARTBEAT": "0.1"}
    with dispatched(first, 1, settings, _TAKE_SLOWLY, **given, **beats) as process:
        said, _ = process.communicate(timeout=60)
    assert said.splitlines()[-1] == "took 4 holds 4"


class LosesAnswers:
    """The record, which loses the answer to each first write of a claim, after it is committed."""

    def __init__(self, store: PostgresJobStore) -> None:
        self._store = store
        self._lost = set[str]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._store, name)

    def save(self, job: Job, **said: Any) -> None:
        self._store.save(job, **said)
        if job.id not in self._lost:
            self._lost.add(job.id)
            raise RecordsUnavailable("no answer within 2 s")


def test_a_companions_claim_whose_answer_is_lost_is_repeated(
    job_store: PostgresJobStore, redis_client: redis.Redis
) -> None:
    """M1: nobody held the attempt that was committed, and it counted as a lost worker's."""
    first, *others = trials(job_store, redis_client, 3, max_attempts=1)
    store: Any = LosesAnswers(job_store)
    claim = partial(
        claim_attempt, worker="w", store=store, objects=MemoryObjectStore(), lease=timedelta(seconds=15)
    )
    found = list(tasks._companions(first, "gpu:0", "w", store, claim, 15, lambda: False))
    assert [one.job_id for one in found] == [job.id for job in others]
    for one in found:
        held = job_store.get(one.job_id)
        assert (held.token, len(held.attempts)) == (one.token, 1)
        assert job_store.renew(one.job_id, one.token, timedelta(seconds=15)) == "starting"


def test_a_drain_ends_the_claiming_of_companions(
    job_store: PostgresJobStore, redis_client: redis.Redis
) -> None:
    """M1: during an outage, too."""
    first, *_ = trials(job_store, redis_client, 3)

    def unavailable(*_: Any, **__: Any) -> None:
        raise RecordsUnavailable("away")

    store: Any = job_store
    assert list(tasks._companions(first, "gpu:0", "w", store, unavailable, 15, lambda: True)) == []
