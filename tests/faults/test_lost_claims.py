"""PostgreSQL is killed right after a claim, whose commit does not wait for the disk."""

from collections.abc import Callable, Iterator
from datetime import timedelta
from functools import partial

import psycopg
import pytest

from core.accounts.store import Actor
from core.adapters.postgres.store import PostgresJobStore
from core.errors import LeaseLost, StaleJob
from core.jobs.attempts import Claim, claim_turn
from core.jobs.job import Job
from core.jobs.queue import queue_names
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.jobs.turns import Quota
from core.reasons import Reason
from core.retry import retry_while_unavailable
from tests.contract.recording import LEASE, Database, artifact, line, statuses, texts
from tests.faults.outages import Outages, pooled, submitted
from tests.in_memory import MemoryJobQueue, MemoryObjectStore


class Log:
    """How far the server has come with its log, in bytes. inserted: in memory; written: to its files."""

    def __init__(self, database: Database) -> None:
        self._database = database

    @property
    def inserted(self) -> int:
        [(number,)] = self._database.read("SELECT pg_current_wal_insert_lsn() - '0/0'")
        return number

    @property
    def written(self) -> int:
        [(number,)] = self._database.read("SELECT pg_current_wal_lsn() - '0/0'")
        return number


@pytest.fixture
def url(postgres: Outages) -> str:
    return postgres.fresh()


@pytest.fixture
def log(url: str) -> Iterator[Log]:
    with psycopg.connect(url, autocommit=True) as connection:
        yield Log(Database(connection))


@pytest.fixture
def store(url: str) -> Iterator[PostgresJobStore]:
    store = pooled(url)
    yield store
    store.close()


def take(store: JobStore, secret: str) -> Claim:
    claim = claim_turn(
        queue_names("cpu"),
        f"worker of {secret}",
        store=store,
        objects=MemoryObjectStore(),
        lease=LEASE,
        secret=secret,
    )
    assert claim is not None
    return claim


# With a quota of running jobs, a claim is a transaction of several statements.
@pytest.mark.parametrize("quota", [Quota(), Quota(running=1)])
def test_a_claim_that_is_lost_with_the_server_is_a_lost_lease(
    quota: Quota, postgres: Outages, log: Log, store: PostgresJobStore
) -> None:
    store.set_quota("project", "default", quota, Actor())
    queue = MemoryJobQueue()
    job = submitted(store, queue)
    message = queue.take()
    with postgres.crash():
        before = log.inserted
        lost = take(store, "first")
        claimed = store.get(job.id)
        assert claimed.token == lost.token
        assert log.written <= before < log.inserted, "The claim is in the files: it would not be lost."
    assert retry_while_unavailable(partial(store.get, job.id)) == job

    with pytest.raises(LeaseLost):
        store.renew(job.id, lost.token, LEASE)
    # Its worker ends, and RQ forgets the message.
    assert message is not None
    queue.remove(message.job_id, message.attempt)
    assert queue.waiting() == []
    reconciler = Reconciler(store, queue, LEASE)
    reconciler.run_once()
    assert reconciler.run_once() == 1
    assert queue.take() == message

    second = take(store, "second")
    found = store.get(job.id)
    assert (found.id, found.version, second.number) == (job.id, claimed.version, lost.number)
    for refusal, write in writes(store, lost, claimed):
        with pytest.raises(refusal):
            write()
        assert store.get(job.id) == found
    assert texts(store.feed(job.id, "logs").entries) == []
    assert [entry.data["status"] for entry in statuses(store, job)] == ["starting"]
    assert store.renew(job.id, second.token, LEASE).status == JobStatus.STARTING
    second.start(device="cpu")
    ended = second.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.")
    assert [attempt.worker for attempt in ended.attempts] == ["worker of second"]
    assert sum(entry.attempts for entry in store.usage(job.created_at).projects) == 1


def writes(store: JobStore, lost: Claim, claimed: Job) -> list[tuple[type[Exception], Callable[[], object]]]:
    """All that the lost claim's worker may still send. claimed: the job as it has read it before."""
    return [
        (LeaseLost, lambda: store.renew(lost.job_id, lost.token, LEASE)),
        (LeaseLost, lambda: store.record(lost.job_id, lost.token, "logs", [line("a")], write_id="1")),
        (LeaseLost, lambda: lost.start(device="cpu")),
        (LeaseLost, lambda: lost.publish((artifact("a.png"),), 1)),
        (LeaseLost, lambda: lost.give_back(Reason.WORKER_DRAINED, "Shut down.")),
        (LeaseLost, lambda: lost.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.")),
        # Between reading and writing, the server was killed and the second claim came.
        (StaleJob, lambda: store.save(claimed.running(device="cpu"))),
        (StaleJob, lambda: store.save(claimed.become(JobStatus.CANCELLING))),
    ]


def test_a_claim_whose_lease_was_renewed_outlives_the_server(
    postgres: Outages, log: Log, store: PostgresJobStore
) -> None:
    job = submitted(store, MemoryJobQueue())
    with postgres.crash():
        claim = take(store, "first")
        after = log.inserted
        assert log.written < after
        store.renew(job.id, claim.token, LEASE)
        assert log.written >= after
    assert retry_while_unavailable(partial(store.get, job.id)).token == claim.token
    assert store.renew(job.id, claim.token, timedelta(seconds=1)).status == JobStatus.STARTING
