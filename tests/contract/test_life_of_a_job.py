"""The life of a job as a state machine, on the real record: users, workers and the reconciler in any order.

Workers here are of the worst sort: they go on writing after their jobs were taken from them, and they send
again what was answered long ago.
"""

from dataclasses import dataclass, field
from datetime import timedelta

import pytest
from hypothesis import settings, strategies
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, rule, run_state_machine_as_test
from sqlalchemy import Engine, text

from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.errors import JobFinished, JobNotFinished, JobNotFound, LeaseLost
from core.jobs import feeds
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.ending import cancel, delete
from core.jobs.job import Artifact, Job
from core.jobs.reconciliation import Reconciler
from core.jobs.spec import JOB_SPEC
from core.jobs.status import NEXT, JobStatus
from core.jobs.store import Entry
from core.jobs.submission import submit
from core.reasons import Reason
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue, MemoryObjectStore

LEASE = timedelta(minutes=5)
SPEC = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", "max_attempts": 3})


@dataclass
class Known:
    """An observer's memory of a job."""

    job: Job
    claims: list[Claim] = field(default_factory=list[Claim])
    published: set[str] = field(default_factory=set[str])
    said: int = 0
    deleted: bool = False


class Life(RuleBasedStateMachine):
    jobs = Bundle("jobs")

    def __init__(self, store: PostgresJobStore, engine: Engine) -> None:
        super().__init__()
        self.store, self.engine = store, engine
        self.queue, self.objects = MemoryJobQueue(), MemoryObjectStore()
        self.reconciler = Reconciler(store, self.queue, LEASE)
        self.known: list[Known] = []

    @rule(target=jobs)
    def a_user_submits(self) -> Known:
        known = Known(submit(SPEC, store=self.store, queue=self.queue))
        self.known.append(known)
        return known

    @rule(known=jobs)
    def a_user_cancels(self, known: Known) -> None:
        try:
            cancel(known.job.id, store=self.store, queue=self.queue)
        except JobFinished:
            assert known.job.status.is_final
        except JobNotFound:
            assert known.deleted

    @rule(known=jobs)
    def a_user_deletes(self, known: Known) -> None:
        try:
            delete(known.job.id, store=self.store, objects=self.objects)
        except JobNotFinished:
            assert not known.job.status.is_final
        except JobNotFound:
            assert known.deleted
        else:
            known.deleted = True

    @rule(known=jobs, number=strategies.integers(1, 4))
    def a_worker_claims_by_some_dispatch(self, known: Known, number: int) -> None:
        """Perhaps an old one, or one that nobody has sent yet."""
        secret = new_secret()
        for _ in range(2):  # The answer to the first is lost.
            try:
                claim = claim_attempt(
                    known.job.id,
                    number,
                    "worker",
                    store=self.store,
                    objects=self.objects,
                    lease=LEASE,
                    secret=secret,
                )
            except JobNotFound:
                assert known.deleted
                return
            expected = known.job.status is JobStatus.QUEUED and known.job.next_attempt == number
            assert (claim is not None) == expected
        if claim is not None:
            known.claims.append(claim)

    @rule(known=jobs, data=strategies.data())
    def a_worker_reports(self, known: Known, data: strategies.DataObject) -> None:
        for claim in self._one_of(known, data):
            entry = Entry(kind="line", time=self.store.now(), data={"text": str(known.said)})
            try:
                for _ in range(2):
                    self.store.record(
                        claim.job_id, claim.token, "logs", [entry], write_id=f"write {known.said}"
                    )
            except LeaseLost:
                assert not self._holds(known, claim)
            else:
                assert self._holds(known, claim)
                known.said += 1

    @rule(known=jobs, data=strategies.data())
    def a_worker_publishes(self, known: Known, data: strategies.DataObject) -> None:
        for claim in self._one_of(known, data):
            name = f"file-{claim.number}-{len(known.published)}"
            artifact = Artifact(
                name=name, role="picture", media_type="image/png", size=1, sha256="0" * 64, key=name
            )
            try:
                claim.publish((artifact,), 5)
            except (LeaseLost, JobNotFound):
                assert not self._holds(known, claim)
            else:
                assert self._holds(known, claim)
                known.published.add(name)

    @rule(
        known=jobs,
        data=strategies.data(),
        reason=strategies.sampled_from((Reason.COMPLETED, Reason.DIVERGED)),
    )
    def a_worker_ends_its_attempt(self, known: Known, data: strategies.DataObject, reason: Reason) -> None:
        status = JobStatus.SUCCEEDED if reason is Reason.COMPLETED else JobStatus.FAILED
        for claim in self._one_of(known, data):
            held, before = self._holds(known, claim), known.job
            try:
                for _ in range(2):
                    job = claim.end(status, reason, "")
            except (LeaseLost, JobNotFound):
                assert not held
            else:
                # What was said once, perhaps long ago, may be said again and changes nothing.
                assert job.status is status if held else job == before

    @rule(
        known=jobs,
        data=strategies.data(),
        reason=strategies.sampled_from((Reason.WORKER_DRAINED, Reason.TRAINING_KILLED)),
    )
    def a_worker_gives_its_job_back(self, known: Known, data: strategies.DataObject, reason: Reason) -> None:
        for claim in self._one_of(known, data):
            held, before = self._holds(known, claim), known.job
            try:
                for _ in range(2):
                    job = claim.give_back(reason, "")
            except (LeaseLost, JobNotFound):
                assert not held
            else:
                assert held or job == before
                assert job.status is not JobStatus.RUNNING

    @rule(known=jobs)
    def its_worker_falls_silent(self, known: Known) -> None:
        with self.engine.begin() as connection:
            connection.execute(
                text(
                    "UPDATE jobs SET lease_until = now() - interval '1 second' WHERE id = :id AND token != ''"
                ),
                {"id": known.job.id},
            )

    @rule()
    def the_reconciler_looks(self) -> None:
        with self.engine.begin() as connection:  # It has been looking all the time.
            connection.execute(text("UPDATE pulse SET beat_at = now(), quiet_until = now() - interval '1 s'"))
        self.reconciler.run_once()

    @rule()
    def redis_is_emptied(self) -> None:
        self.queue = self.reconciler._queue = MemoryJobQueue()  # type: ignore[assignment]

    @rule()
    def feeds_are_compacted(self) -> None:
        feeds.compact(store=self.store, objects=self.objects)

    @invariant()
    def every_job_is_where_it_may_be(self) -> None:
        for known in self.known:
            try:
                job = self.store.get(known.job.id)
            except JobNotFound:
                assert known.deleted
                continue
            assert not known.deleted
            self._check(known, job)
            known.job = job

    def _check(self, known: Known, job: Job) -> None:
        before = known.job
        assert job.version >= before.version
        if job.version == before.version:
            assert job == before
        if before.status.is_final:
            assert job.status is before.status
        elif job.status is not before.status:
            assert _is_reachable(before.status, job.status)
        assert {a.name for a in job.artifacts} == known.published
        assert [attempt.number for attempt in job.attempts] == list(range(1, len(job.attempts) + 1))
        assert all(attempt.ended_at for attempt in job.attempts[:-1])
        said = read_feed(job.id, "logs", store=self.store, objects=self.objects)
        assert [entry.data["text"] for entry in said] == [str(number) for number in range(known.said)]
        assert [entry.id for entry in said] == [str(number) for number in range(1, known.said + 1)]

    def _one_of(self, known: Known, data: strategies.DataObject) -> list[Claim]:
        """An attempt at the job that a worker once had; nothing where nobody ever had one."""
        return [data.draw(strategies.sampled_from(known.claims))] if known.claims else []

    def _holds(self, known: Known, claim: Claim) -> bool:
        return not known.deleted and known.job.token == claim.token


def _is_reachable(start: JobStatus, end: JobStatus) -> bool:
    """In one step or several: a rule may take more than one."""
    reached, seen = set(NEXT[start]), {start}
    while reached - seen:
        new = reached - seen
        seen |= new
        reached |= {step for status in new for step in NEXT[status]}
    return end in reached


@pytest.mark.timeout(300)
def test_no_order_of_events_breaks_the_life_of_a_job(database_url: str) -> None:
    engine = connect_postgres(database_url)
    store = PostgresJobStore(engine)
    run_state_machine_as_test(  # type: ignore[no-untyped-call]
        lambda: Life(store, engine),
        settings=settings(max_examples=25, stateful_step_count=25, deadline=None),
    )
    store.close()
