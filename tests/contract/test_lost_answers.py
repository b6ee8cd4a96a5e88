"""A write whose answer was lost is sent again, and the second one changes nothing."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import psycopg
import pytest

from core.accounts.store import Actor
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.errors import JobExists, JobNotFound, LeaseLost, RecordsUnavailable, StaleJob
from core.jobs.attempts import Claim, claim_attempt
from core.jobs.job import Job, Progress
from core.jobs.patch import JobPatch
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch, Idempotency, JobQuery
from core.jobs.turns import Quota
from core.reasons import Reason
from tests.contract.recording import (
    LEASE,
    MODEL,
    NOW,
    Database,
    artifact,
    chunk_of,
    held,
    line,
    model,
    queued_job,
    say,
    statuses,
    taken_back,
    texts,
    watch,
    worker,
)
from tests.in_memory import MemoryObjectStore


class Unsure:
    """A record of which the answer to the next write, or its request, can get lost."""

    def __init__(self, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self._url = url
        engine = connect_postgres(url)
        self.jobs = PostgresJobStore(engine)
        self._dialect = engine.dialect
        self._commit, self._execute = engine.dialect.do_commit, engine.dialect.do_execute
        self._replace = partial(monkeypatch.setattr, engine.dialect)

    @contextmanager
    def losing_answer(self) -> Iterator[None]:
        """The next write is committed, and then its connection breaks."""
        with self._breaking(self._end_and_break):
            yield

    @contextmanager
    def losing_request(self) -> Iterator[None]:
        """The server ends the connection of the next write before it is committed."""
        with self._breaking(self._break_and_end):
            yield

    @contextmanager
    def _breaking(self, at_end: Callable[[Any, Callable[[], None]], None]) -> Iterator[None]:
        """at_end: what becomes of the step that commits: a COMMIT, or a statement that needs none."""

        def commit(connection: Any) -> None:
            end = partial(self._commit, connection)
            at_end(connection.driver_connection, end) if _is_write(connection) else end()

        def execute(cursor: Any, statement: str, *more: Any) -> None:
            end = partial(self._execute, cursor, statement, *more)
            is_write = cursor.connection.autocommit and re.search(r"\b(INSERT|UPDATE|DELETE)\b", statement)
            at_end(cursor.connection, end) if is_write else end()

        self._replace("do_commit", commit)
        self._replace("do_execute", execute)
        with pytest.raises(RecordsUnavailable):
            yield
        assert self._dialect.do_commit == self._commit, "Nothing was written."

    def _mend(self) -> None:
        self._replace("do_commit", self._commit)
        self._replace("do_execute", self._execute)

    def _end_and_break(self, connection: Any, end: Callable[[], None]) -> None:
        end()
        self._mend()
        connection.close()
        raise psycopg.OperationalError("server closed the connection unexpectedly")

    def _break_and_end(self, connection: Any, end: Callable[[], None]) -> None:
        self._mend()
        with psycopg.connect(self._url) as other:
            other.execute("SELECT pg_terminate_backend(%s, 5000)", [connection.info.backend_pid])
        end()


def _is_write(connection: Any) -> bool:
    (number,) = connection.driver_connection.execute("SELECT pg_current_xact_id_if_assigned()").fetchone()
    return number is not None


@pytest.fixture
def unsure(database_url: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Unsure]:
    unsure = Unsure(database_url, monkeypatch)
    yield unsure
    unsure.jobs.close()


@pytest.fixture
def jobs(unsure: Unsure) -> PostgresJobStore:
    return unsure.jobs


@pytest.fixture
def job(jobs: PostgresJobStore) -> Job:
    """A job that an attempt holds."""
    return held(jobs, queued_job())


class TestLostAnswers:
    def test_a_job_is_added_once(self, unsure: Unsure, jobs: PostgresJobStore) -> None:
        new = queued_job()
        with unsure.losing_answer():
            jobs.add(new)
        with pytest.raises(JobExists):
            jobs.add(new)
        assert list(jobs.list(JobQuery()).jobs) == [new]
        assert jobs.undispatched() == [Dispatch("attempt", new.id, 1)]

    def test_a_submission_with_a_key_gets_the_job_that_it_made(
        self, unsure: Unsure, jobs: PostgresJobStore
    ) -> None:
        first, again = queued_job(0), queued_job(1)
        with unsure.losing_answer():
            jobs.add(first, Idempotency("k", "body"))
        assert jobs.add(again, Idempotency("k", "body")) == first
        assert list(jobs.list(JobQuery()).jobs) == [first]

    def test_a_step_is_saved_once(self, unsure: Unsure, jobs: PostgresJobStore, job: Job) -> None:
        with unsure.losing_answer():
            jobs.save(job.running())
        with pytest.raises(StaleJob):
            jobs.save(job.running())
        assert jobs.get(job.id) == job.running()
        assert len(statuses(jobs, job)) == 2

    def test_lines_are_written_once(self, unsure: Unsure, jobs: PostgresJobStore, job: Job) -> None:
        write = partial(jobs.record, job.id, job.token, "logs", [line("a"), line("b")], write_id="2")
        say(jobs, job, "before")
        with unsure.losing_answer():
            write()
        write()
        write()
        assert texts(jobs.feed(job.id, "logs").entries) == ["before", "a", "b"]

    def test_a_write_goes_on_to_change_nothing_after_steps_and_renewals(
        self, jobs: PostgresJobStore, job: Job
    ) -> None:
        write = partial(
            jobs.record, job.id, job.token, "logs", [line("once")], Progress(step=1), write_id="w"
        )
        write()
        jobs.save(job.running())
        jobs.renew(job.id, job.token, LEASE)
        write()
        assert texts(jobs.feed(job.id, "logs").entries) == ["once"]
        assert jobs.get(job.id).progress == Progress(step=1)

    def test_the_same_words_in_another_write_are_other_words(self, jobs: PostgresJobStore, job: Job) -> None:
        for write_id in ("1", "2"):
            jobs.record(job.id, job.token, "logs", [line("a")], write_id=write_id)
        assert texts(jobs.feed(job.id, "logs").entries) == ["a", "a"]

    def test_a_job_is_taken_back_once(
        self, unsure: Unsure, jobs: PostgresJobStore, job: Job, database: Database
    ) -> None:
        watch(jobs, database)
        database.end_lease(job)
        with unsure.losing_answer():
            jobs.take_back(taken_back(job))
        with pytest.raises(StaleJob):
            jobs.take_back(taken_back(job))
        assert jobs.get(job.id) == taken_back(job)
        assert jobs.undispatched() == [Dispatch("attempt", job.id, 2)]

    def test_a_job_is_deleted_once(self, unsure: Unsure, jobs: PostgresJobStore, job: Job) -> None:
        with unsure.losing_answer():
            jobs.delete(job.id, job.version)
        with pytest.raises(JobNotFound):
            jobs.delete(job.id, job.version)

    def test_a_chunk_is_named_once(self, unsure: Unsure, jobs: PostgresJobStore, job: Job) -> None:
        say(jobs, job, "a", "b")
        chunk = chunk_of(jobs.oldest_entries(job.id, "logs", limit=1))
        with unsure.losing_answer():
            jobs.replace_by_chunk(job.id, chunk)
        jobs.replace_by_chunk(job.id, chunk)
        part = jobs.feed(job.id, "logs")
        assert (list(part.chunks), texts(part.entries)) == ([chunk], ["b"])

    def test_what_replaces_itself_is_simply_sent_again(
        self, unsure: Unsure, jobs: PostgresJobStore, job: Job
    ) -> None:
        waiting = queued_job(1)
        jobs.add(waiting)
        for write in (
            partial(jobs.renew, job.id, job.token, LEASE),
            partial(jobs.beat, LEASE),
            partial(jobs.patch, job.id, JobPatch(name="b")),
            partial(jobs.dispatched, [Dispatch("attempt", waiting.id, 1)]),
            partial(jobs.models.add, model(status="validating")),
            partial(jobs.models.dispatched, MODEL),
            partial(jobs.models.settle, model()),
            partial(jobs.models.delete, MODEL),
            partial(jobs.announce, worker("a"), LEASE),
            partial(jobs.withdraw, "a"),
        ):
            with unsure.losing_answer():
                write()
            write()
        assert (list(jobs.models.all()), list(jobs.workers()), jobs.undispatched()) == ([], [], [])


class TestLostRequests:
    def test_what_broke_off_before_its_commit_did_nothing_and_is_sent_again(
        self, unsure: Unsure, jobs: PostgresJobStore
    ) -> None:
        job = queued_job()
        claimed = job.claimed("worker-1", NOW)
        steps = [
            (
                partial(jobs.add, job, Idempotency("k", "body")),
                lambda: list(jobs.list(JobQuery()).jobs) == [job],
            ),
            (partial(jobs.save, claimed, lease=LEASE), lambda: jobs.get(job.id) == claimed),
            (
                partial(
                    jobs.record, job.id, claimed.token, "logs", [line("a")], Progress(step=1), write_id="w"
                ),
                lambda: texts(jobs.feed(job.id, "logs").entries) == ["a"],
            ),
            (
                partial(jobs.save, claimed.with_artifacts((artifact("a"),))),
                lambda: set(jobs.objects_named([job.id])) == {"of a"},
            ),
            (partial(jobs.delete, job.id, 3), lambda: list(jobs.list(JobQuery()).jobs) == []),
        ]
        for write, was_done in steps:
            with unsure.losing_request():
                write()
            assert not was_done()
            write()
            assert was_done()


class TestAttempts:
    """Do as a worker that does not know whether it was heard."""

    @pytest.fixture
    def objects(self) -> MemoryObjectStore:
        return MemoryObjectStore()

    @pytest.fixture
    def claim(self, jobs: PostgresJobStore, job: Job, objects: MemoryObjectStore) -> Claim:
        return Claim(job.id, 1, job.token, jobs, objects)

    def test_a_claim_sent_again_finds_what_it_took(
        self, unsure: Unsure, jobs: PostgresJobStore, objects: MemoryObjectStore
    ) -> None:
        job = queued_job()
        jobs.add(job)
        take = partial(claim_attempt, job.id, 1, "w", store=jobs, objects=objects, lease=LEASE)
        with unsure.losing_answer():
            take(secret="mine")
        claimed = jobs.get(job.id)
        assert claimed.status == JobStatus.STARTING
        assert take(secret="another's") is None
        claim = take(secret="mine")
        assert claim is not None
        assert jobs.get(job.id) == claimed
        assert jobs.renew(job.id, claim.token, LEASE).status == JobStatus.STARTING

    def test_a_claim_that_broke_off_is_open_to_all(
        self, unsure: Unsure, jobs: PostgresJobStore, objects: MemoryObjectStore
    ) -> None:
        job = queued_job()
        jobs.add(job)
        take = partial(claim_attempt, job.id, 1, "w", store=jobs, objects=objects, lease=LEASE)
        with unsure.losing_request():
            take(secret="mine")
        assert jobs.get(job.id) == job
        assert take(secret="another's") is not None
        assert take(secret="mine") is None

    def test_a_turn_whose_answer_was_lost_is_the_same_again(
        self, unsure: Unsure, jobs: PostgresJobStore
    ) -> None:
        first, second = jobs.add(queued_job()), jobs.add(queued_job(1))
        take = partial(jobs.take_turn, queue_names("cpu"), "w", lease=LEASE)
        with unsure.losing_answer():
            take(secret="mine")
        claimed = jobs.get(first.id)
        assert claimed.status == JobStatus.STARTING
        assert take(secret="mine") == claimed
        others = take(secret="another's")
        assert others is not None
        assert others.id == second.id
        assert len(statuses(jobs, first)) == 1

    @pytest.mark.parametrize("quota", [Quota(), Quota(running=1)])
    def test_a_turn_that_broke_off_is_open_to_all(
        self, unsure: Unsure, jobs: PostgresJobStore, quota: Quota
    ) -> None:
        jobs.set_quota("project", "default", quota, Actor())
        job = jobs.add(queued_job())
        take = partial(jobs.take_turn, queue_names("cpu"), "w", lease=LEASE)
        with unsure.losing_request():
            take(secret="mine")
        assert jobs.get(job.id) == job
        others = take(secret="another's")
        assert others is not None
        assert others.id == job.id
        assert take(secret="mine") is None

    def test_a_start_sent_again_leaves_the_job_running(
        self, unsure: Unsure, jobs: PostgresJobStore, claim: Claim
    ) -> None:
        with unsure.losing_answer():
            claim.start(device="cpu")
        claim.start(device="cpu")
        job = jobs.get(claim.job_id)
        assert (job.status, job.attempts[0].device) == (JobStatus.RUNNING, "cpu")
        assert [entry.data["status"] for entry in statuses(jobs, job)] == ["starting", "running"]

    def test_a_publication_sent_again_names_the_same_files_and_drops_none_of_them(
        self, unsure: Unsure, jobs: PostgresJobStore, claim: Claim
    ) -> None:
        kept, newer = (artifact(f"checkpoint-{step}", role="checkpoint", step=step) for step in (10, 20))
        claim.publish((kept,), 1)
        with unsure.losing_answer():
            claim.publish((newer,), 1)
        job, dropped = claim.publish((newer,), 1)
        assert job.artifacts == jobs.get(job.id).artifacts == (newer,)
        assert newer.key not in dropped

    @pytest.mark.parametrize("reason", [Reason.DIVERGED, Reason.WORKER_LOST])
    def test_an_end_sent_again_is_the_same_end(
        self, unsure: Unsure, jobs: PostgresJobStore, claim: Claim, reason: Reason
    ) -> None:
        end = partial(claim.end, JobStatus.FAILED, reason, "NaN at 7")
        with unsure.losing_answer():
            end()
        ended = jobs.get(claim.job_id)
        assert end() == jobs.get(claim.job_id) == ended
        assert ended.status == JobStatus.FAILED

    @pytest.mark.parametrize("reason", [Reason.WORKER_DRAINED, Reason.TRAINING_KILLED, Reason.WORKER_LOST])
    def test_a_job_given_back_again_stays_whosever_it_is_by_then(
        self, unsure: Unsure, jobs: PostgresJobStore, claim: Claim, reason: Reason
    ) -> None:
        give_back = partial(claim.give_back, reason, "Bye.")
        with unsure.losing_answer():
            give_back()
        queued = jobs.get(claim.job_id)
        assert give_back() == queued
        jobs.save(claimed := queued.claimed("worker-2", NOW), lease=LEASE)
        assert give_back() == claimed
        assert jobs.get(claimed.id) == claimed

    def test_an_attempt_whose_job_was_taken_back_is_told_so(
        self, jobs: PostgresJobStore, job: Job, claim: Claim
    ) -> None:
        jobs.save(taken := taken_back(job))
        for leave in (
            partial(claim.end, JobStatus.SUCCEEDED, Reason.COMPLETED, "Done."),
            partial(claim.give_back, Reason.WORKER_DRAINED, "Bye."),
            partial(claim.give_back, Reason.WORKER_LOST, "Its slot was taken."),
        ):
            with pytest.raises(LeaseLost):
                leave()
        assert jobs.get(job.id) == taken
