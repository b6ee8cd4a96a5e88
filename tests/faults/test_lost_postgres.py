"""PostgreSQL is silent, away, or dies with an answer: who works keeps the job, who is dead loses it, once."""

import random
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import psycopg
import pytest

from core.adapters.postgres.engine import PromptConnection
from core.adapters.postgres.store import PostgresJobStore
from core.errors import JobNotFound, RecordsUnavailable
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.ending import cancel, delete
from core.jobs.job import Artifact, Job, utc_now
from core.jobs.reconciliation import Reconciler
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Entry, Idempotency, JobQuery
from core.jobs.submission import Acknowledgements, submit
from core.reasons import Reason
from core.retry import retry_while_unavailable
from tests.contract.recording import Database, watch
from tests.faults.bench import unused_servers, wait_until
from tests.faults.outages import Outages, Watch, pooled, submitted
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from worker.stopping import Draining
from worker.supervision.watching import Heartbeat

pytestmark = pytest.mark.extra

# About that of a worker: nothing waits for its end, and no busy machine keeps a heart from beating so long.
LONG = timedelta(seconds=15)
# Of what happens in real time.
SHORT = timedelta(seconds=2)
NUM_JOBS = 16


class Fleet:
    """Jobs that attempts hold, and two reconcilers that watch them; each as a process of its own would."""

    def __init__(self, url: str, data_dir: Path, lease: timedelta = LONG) -> None:
        # Rare enough that reconcilers are the first to look after an outage.
        self.lease, self.heartbeat = lease, lease / 12
        self._url = url
        self._stack = ExitStack()
        self.store = self._connected(url, NUM_JOBS)
        self.queue, self.objects = MemoryJobQueue(), MemoryObjectStore()
        self._watches = [Watch(self._connected(url), self.queue, lease, every_s=0.2) for _ in range(2)]
        settings = unused_servers(data_dir).model_copy(update={"lease": lease, "heartbeat": self.heartbeat})
        self.claims = [self._hold() for _ in range(NUM_JOBS)]
        self._hearts = {claim.job_id: Heartbeat(claim, settings, Draining()) for claim in self.claims}

    def __enter__(self) -> "Fleet":
        self._stack.callback(self._end_hearts)
        for heart in self._hearts.values():
            heart.__enter__()
            time.sleep(self.heartbeat.total_seconds() / NUM_JOBS)  # No two of them beat as one.
        for running in self._watches:
            self._stack.enter_context(running)
        self.watch_on()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def kill(self, claim: Claim) -> None:
        """Its heart beats no more."""
        self._hearts.pop(claim.job_id).__exit__()

    def pass_time(self, span: timedelta) -> None:
        """As an outage of this length does."""
        with self._database() as database:
            database.pass_time(span)

    def watch_on(self) -> None:
        """Return when leases are enforced again, and have been looked at since."""
        self._after_looks()
        # From the first look after an outage no lease ends, for the time of one: each heart beats in it.
        with self._database() as database:
            [(now,)] = database.read("SELECT now()")
            silent = "SELECT count(*) FROM jobs WHERE id = ANY(%s) AND lease_until < %s"
            wait_until(lambda: database.read(silent, list(self._hearts), now + self.lease) == [(0,)])
            database.change("UPDATE pulse SET quiet_until = now() - interval '1 s'")
        self._after_looks()

    def attempts(self, claims: list[Claim]) -> list[list[Reason | None]]:
        """How the attempts at these jobs ended; None for one that goes on."""
        found = [retry_while_unavailable(partial(self.store.get, claim.job_id)) for claim in claims]
        return [[attempt.reason for attempt in job.attempts] for job in found]

    def _after_looks(self) -> None:
        """Both have begun a look, and ended it."""
        wanted = [w.num_looks + 2 for w in self._watches]
        wait_until(lambda: all(w.num_looks >= n for w, n in zip(self._watches, wanted, strict=True)))

    @contextmanager
    def _database(self) -> Iterator[Database]:
        with psycopg.connect(self._url, autocommit=True) as connection:
            yield Database(connection)

    def _end_hearts(self) -> None:
        for heart in self._hearts.values():
            heart.__exit__()

    def _connected(self, url: str, pool_size: int = 2) -> PostgresJobStore:
        store = pooled(url, pool_size)
        self._stack.callback(store.close)
        return store

    def _hold(self) -> Claim:
        submitted(self.store, self.queue)
        dispatch = self.queue.take()
        assert dispatch is not None
        claim = claim_attempt(
            dispatch.job_id,
            dispatch.attempt,
            "w",
            store=self.store,
            objects=self.objects,
            lease=self.lease,
            secret=new_secret(),
        )
        assert claim is not None
        return claim


@pytest.mark.parametrize("rounds", [3, pytest.param(30, marks=[pytest.mark.slow, pytest.mark.timeout(400)])])
@pytest.mark.parametrize("outage", ["silence", "absence"])
def test_who_works_keeps_the_job_through_an_outage_longer_than_its_lease(
    outage: str, rounds: int, postgres: Outages, tmp_path: Path
) -> None:
    chance = random.Random(outage)
    with Fleet(postgres.fresh(), tmp_path) as fleet:
        for _ in range(rounds):
            fleet.pass_time(chance.uniform(1.2, 2.5) * fleet.lease)
            with getattr(postgres, outage)():
                time.sleep(chance.uniform(0.3, 0.8))
            fleet.watch_on()
            assert fleet.attempts(fleet.claims) == [[None]] * NUM_JOBS


def test_who_works_keeps_the_job_through_a_silence_in_which_every_call_gives_up(
    postgres: Outages, tmp_path: Path
) -> None:
    # A call gives up after 2 s, and others are not tried for a second.
    with Fleet(postgres.fresh(), tmp_path) as fleet:
        fleet.pass_time(1.2 * fleet.lease)
        with postgres.silence():
            time.sleep(3.5)
        fleet.watch_on()
        assert fleet.attempts(fleet.claims) == [[None]] * NUM_JOBS


@pytest.mark.parametrize("outage", ["silence", "absence"])
def test_who_died_before_an_outage_loses_the_job_once_and_a_lease_after_it(
    outage: str, postgres: Outages, tmp_path: Path
) -> None:
    with Fleet(postgres.fresh(), tmp_path, SHORT) as fleet:
        dead, *alive = fleet.claims
        fleet.kill(dead)
        fleet.pass_time(1.2 * fleet.lease)
        with getattr(postgres, outage)():
            time.sleep(0.6 * SHORT.total_seconds())  # More than half a lease is a silence.
            back_at = utc_now()
        wait_until(lambda: fleet.attempts([dead]) != [[None]])
        fleet.watch_on()
        assert fleet.attempts([dead]) == [[Reason.WORKER_LOST]]
        assert fleet.attempts(alive) == [[None]] * len(alive)
        (attempt,) = fleet.store.get(dead.job_id).attempts
        assert attempt.ended_at is not None
        assert attempt.ended_at - back_at > 0.9 * SHORT
        assert [(d.job_id, d.attempt) for d in fleet.queue.waiting()] == [(dead.job_id, 2)]


@pytest.fixture
def url(postgres: Outages) -> str:
    return postgres.fresh()


@pytest.fixture
def store(url: str) -> Iterator[PostgresJobStore]:
    store = pooled(url)
    yield store
    store.close()


def test_a_silence_between_a_pulse_and_the_look_at_the_leases_costs_nobody_a_job(
    url: str, store: PostgresJobStore, postgres: Outages, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service(store)
    claim = service.claim(service.submit(), SHORT)
    reconciler = Reconciler(store, service.queue, SHORT)
    reconciler.run_once()
    with psycopg.connect(url, autocommit=True) as connection:
        watch(store, Database(connection))
    store.renew(claim.job_id, claim.token, SHORT)
    expired = store.expired

    def after_a_silence() -> Any:
        with postgres.silence():
            time.sleep(1.2 * SHORT.total_seconds())
        return expired()

    monkeypatch.setattr(store, "expired", after_a_silence)
    reconciler.run_once()
    assert store.renew(claim.job_id, claim.token, SHORT).status == JobStatus.STARTING


class Service:
    """The record, and what uses it; the rest is in memory."""

    def __init__(self, store: PostgresJobStore) -> None:
        self.store, self.queue, self.objects = store, MemoryJobQueue(), MemoryObjectStore()

    def submit(self, idempotency: Idempotency | None = None) -> Job:
        spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant"})
        heard = Acknowledgements(self.store.dispatched).add_at_once
        return submit(spec, store=self.store, queue=self.queue, idempotency=idempotency, acknowledge=heard)

    def claim(self, job: Job, lease: timedelta = LONG, secret: str = "mine") -> Claim:  # noqa: S107
        claim = claim_attempt(
            job.id, 1, "w", store=self.store, objects=self.objects, lease=lease, secret=secret
        )
        assert claim is not None
        return claim

    def cancel(self, job: Job) -> Job:
        return cancel(job.id, store=self.store, queue=self.queue)

    def statuses(self, job: Job) -> list[str]:
        entries = read_feed(job.id, "events", store=self.store, objects=self.objects)
        return [entry.data["status"] for entry in entries if entry.kind == "status"]


class LostAnswers:
    """Connections that die after a commit and before its answer: as many as `num_left`."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.num_left = 0
        self._commit = PromptConnection.commit
        patch.setattr(PromptConnection, "commit", lambda connection: self._commit_and_die(connection))
        self._execute = psycopg.Cursor.execute
        patch.setattr(psycopg.Cursor, "execute", lambda *sent, **more: self._execute_and_die(*sent, **more))

    def next(self) -> None:
        self.num_left += 1

    def _commit_and_die(self, connection: PromptConnection) -> None:
        row = connection.execute("SELECT pg_current_xact_id_if_assigned()").fetchone()
        assert row is not None
        self._commit(connection)
        if row[0] is not None:
            self._die_if_due(connection)

    def _execute_and_die(self, cursor: "psycopg.Cursor[Any]", query: Any, *more: Any, **named: Any) -> Any:
        done = self._execute(cursor, query, *more, **named)
        if cursor.connection.autocommit and re.search(r"\b(INSERT|UPDATE|DELETE)\b", str(query)):
            self._die_if_due(cursor.connection)
        return done

    def _die_if_due(self, connection: "psycopg.Connection[Any]") -> None:
        if self.num_left:
            self.num_left -= 1
            connection.close()
            raise psycopg.OperationalError("server closed the connection unexpectedly")


class TestLostAnswers:
    """A write that is sent again changes nothing."""

    @pytest.fixture
    def service(self, store: PostgresJobStore) -> Service:
        return Service(store)

    @pytest.fixture
    def lost(self, monkeypatch: pytest.MonkeyPatch, service: Service) -> Iterator[LostAnswers]:
        lost = LostAnswers(monkeypatch)
        yield lost
        assert lost.num_left == 0

    def test_a_claim_is_found_again_by_the_same_secret(self, service: Service, lost: LostAnswers) -> None:
        job = service.submit()
        lost.next()
        claim = retry_while_unavailable(lambda: service.claim(job, secret="mine"))
        found = service.store.get(job.id)
        assert (claim.token, found.token, len(found.attempts)) == ("1-mine", "1-mine", 1)
        assert service.statuses(job) == ["starting"]
        others = claim_attempt(
            job.id, 1, "w", store=service.store, objects=service.objects, lease=LONG, secret="others"
        )
        assert others is None

    @pytest.mark.parametrize(
        ("do", "status", "statuses"),
        [
            (lambda claim: claim.start(device="cpu"), "running", ["running"]),
            (lambda claim: claim.publish((CHECKPOINT,), 1), "starting", []),
            (
                lambda claim: claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done."),
                "succeeded",
                ["succeeded"],
            ),
            (
                lambda claim: claim.give_back(Reason.WORKER_DRAINED, "Shut down."),
                "queued",
                ["queued"],
            ),
        ],
        ids=["start", "publish", "end", "give back"],
    )
    def test_a_step_of_an_attempt_is_taken_once(
        self,
        do: Callable[[Claim], object],
        status: str,
        statuses: list[str],
        service: Service,
        lost: LostAnswers,
    ) -> None:
        job = service.submit()
        claim = service.claim(job)
        lost.next()
        retry_while_unavailable(lambda: do(claim))
        found = service.store.get(job.id)
        assert (found.status, len(found.attempts)) == (status, 1)
        assert service.statuses(job) == ["starting", *statuses]

    def test_entries_of_a_feed_are_there_once_each(self, service: Service, lost: LostAnswers) -> None:
        job = service.submit()
        claim = service.claim(job)
        now = service.store.now()
        for number in range(3):
            lines = [Entry(kind="line", time=now, data={"text": f"{number}{letter}"}) for letter in "ab"]
            lost.next()
            retry_while_unavailable(
                lambda lines=lines, number=number: service.store.record(
                    job.id, claim.token, "logs", lines, write_id=str(number)
                )
            )
        entries = read_feed(job.id, "logs", store=service.store, objects=service.objects)
        assert [entry.data["text"] for entry in entries] == ["0a", "0b", "1a", "1b", "2a", "2b"]

    @pytest.mark.parametrize("is_held", [False, True])
    def test_a_cancel_happens_once(self, is_held: bool, service: Service, lost: LostAnswers) -> None:
        job = service.submit()
        if is_held:
            service.claim(job)
        before, wanted = service.statuses(job), "cancelling" if is_held else "cancelled"
        lost.next()
        assert retry_while_unavailable(lambda: service.cancel(job)).status == wanted
        assert service.statuses(job) == [*before, wanted]

    def test_a_submission_with_a_key_makes_one_job(self, service: Service, lost: LostAnswers) -> None:
        lost.next()
        with pytest.raises(RecordsUnavailable):
            service.submit(Idempotency("key", "fingerprint"))
        job = service.submit(Idempotency("key", "fingerprint"))
        assert [found.id for found in service.store.list(JobQuery()).jobs] == [job.id]
        # It is dispatched by the reconciler: who made it did not come to that.
        assert service.queue.waiting() == []
        assert Reconciler(service.store, service.queue, LONG).run_once() == 1
        assert [dispatch.job_id for dispatch in service.queue.waiting()] == [job.id]

    def test_a_deleted_job_is_not_found(self, service: Service, lost: LostAnswers) -> None:
        job = service.cancel(service.submit())
        lost.next()
        with pytest.raises(JobNotFound):
            retry_while_unavailable(lambda: delete(job.id, store=service.store, objects=service.objects))

    def test_a_job_is_taken_back_and_dispatched_once(
        self, service: Service, lost: LostAnswers, url: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        job = service.submit()
        service.queue.take()
        service.claim(job)
        with psycopg.connect(url, autocommit=True) as connection:
            watch(service.store, Database(connection))
            Database(connection).end_lease(job)
        reconciler = Reconciler(service.store, service.queue, LONG)
        take_back = service.store.take_back

        def and_lose_the_answer(taken: Job) -> None:
            lost.next()
            take_back(taken)

        monkeypatch.setattr(service.store, "take_back", and_lose_the_answer)

        with pytest.raises(RecordsUnavailable):
            reconciler.run_once()
        assert service.queue.waiting() == []
        assert reconciler.run_once() == 1
        assert [(d.job_id, d.attempt) for d in service.queue.waiting()] == [(job.id, 2)]
        assert service.statuses(job) == ["starting", "queued"]


CHECKPOINT = Artifact(
    name="checkpoint-000000000010.msgpack",
    role="checkpoint",
    media_type="application/msgpack",
    size=5,
    sha256="0" * 64,
    key="jobs/checkpoint",
    step=10,
)
