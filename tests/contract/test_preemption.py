"""Running jobs that make room for waiting ones, in the real record."""

from collections.abc import Callable
from datetime import timedelta

import psycopg
import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.jobs.attempts import Claim
from core.jobs.job import Job
from core.jobs.preemption import ASKED_AGAIN_S, DRAINED_WITHIN_S
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.contract.recording import LEASE, NOW, Database, at_once, cancelled
from tests.contract.test_turns import add, take

WORKER = "host:cpu:00000a"


@pytest.fixture
def low(job_store: PostgresJobStore) -> Claim:
    """A training of low priority that has the only worker."""
    info = WorkerInfo(
        name=WORKER, host="host", pid=1, device="cpu", queues=queue_names("cpu"), started_at=NOW, seen_at=NOW
    )
    job_store.announce(info, timedelta(seconds=40))
    add(job_store, "ann", priority="low")
    claim = take(job_store)
    assert claim is not None
    return claim


def hears(claim: Claim) -> str | None:
    return claim.store.renew(claim.job_id, claim.token, LEASE).room_for


def test_a_job_makes_room_and_the_one_that_waited_gets_its_slot(
    job_store: PostgresJobStore, low: Claim
) -> None:
    assert job_store.make_room() == {}
    assert hears(low) is None
    high = add(job_store, "ben", priority="high")
    assert job_store.make_room() == {high.id: [low.job_id]}
    assert hears(low) == f"job {high.id}"
    assert job_store.turn_facts().started[0].yields_to == high.id  # So that a claim keeps the room for it.
    assert job_store.make_room() == {}  # Once.
    low.give_back(Reason.PREEMPTED, "It made room.")
    assert job_store.make_room() == {}  # There is room.
    # At once, and it counts for nothing: the next attempt hears nothing of it.
    given_back = job_store.get(low.job_id)
    assert (given_back.not_before, given_back.lost_attempts) == (None, 0)
    first = take(job_store)
    assert first is not None
    assert first.job_id == high.id
    assert job_store.make_room() == {}
    first.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    again = take(job_store)
    assert again is not None
    assert (again.job_id, hears(again)) == (low.job_id, None)


def test_another_project_is_told_no_name(job_store: PostgresJobStore, low: Claim) -> None:
    add(job_store, "eve", "arms", priority="high")
    assert len(job_store.make_room()) == 1
    assert hears(low) == "a job of another project"


def test_a_cancelled_job_makes_no_room(job_store: PostgresJobStore, low: Claim) -> None:
    add(job_store, priority="high")
    job_store.save(job_store.get(low.job_id).become(JobStatus.CANCELLING))
    assert job_store.make_room() == {}
    assert hears(low) is None


def test_room_for_a_job_that_was_cancelled_is_for_the_next(job_store: PostgresJobStore, low: Claim) -> None:
    first, second = add(job_store, priority="high"), add(job_store, priority="high")
    assert job_store.make_room() == {first.id: [low.job_id]}
    job_store.save(cancelled(first))
    assert job_store.make_room() == {}
    low.give_back(Reason.PREEMPTED, "It made room.")
    claim = take(job_store)
    assert claim is not None
    assert claim.job_id == second.id


def test_a_worker_that_dies_while_it_drains_leaves_no_word_of_it(
    job_store: PostgresJobStore, low: Claim, database: Database
) -> None:
    add(job_store, priority="high")
    job_store.make_room()
    database.change("UPDATE jobs SET lease_until = lease_until - interval '1 h' WHERE id = %s", low.job_id)
    held = job_store.get(low.job_id)
    job_store.save(held.requeued(Reason.WORKER_LOST, "It was silent.", NOW))
    job_store.withdraw(WORKER)
    assert job_store.make_room() == {}
    again = take(job_store)
    assert again is not None  # The one of high priority.
    assert hears(again) is None


def test_several_reconcilers_decide_once(job_store: PostgresJobStore, low: Claim) -> None:
    high = add(job_store, priority="high")
    found = list[dict[str, list[str]]]()
    at_once([lambda: found.append(dict(job_store.make_room()))] * 4, Exception)
    assert [one for one in found if one] == [{high.id: [low.job_id]}]


@pytest.fixture
def alone(job_store: PostgresJobStore, low: Claim) -> PostgresJobStore:
    """The record with a worker that is free."""
    low.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    return job_store


def begin(store: PostgresJobStore, database: Database, **fields: object) -> Claim:
    """A job of Ann's that has run for an hour."""
    add(store, "ann", **fields)
    claim = take(store)
    assert claim is not None
    database.change("UPDATE attempts SET started_at = started_at - interval '1 h' WHERE ended_at IS NULL")
    return claim


def test_a_rollout_makes_no_room_since_it_would_begin_anew(
    alone: PostgresJobStore, database: Database
) -> None:
    begin(alone, database, kind="rollout", policy={"kind": "zero"}, priority="low")
    add(alone, "ben", priority="high")
    assert alone.make_room() == {}


@pytest.mark.parametrize("preemptible", [True, False])
def test_a_preemptible_job_makes_room_for_a_user_who_has_used_less(
    alone: PostgresJobStore, database: Database, preemptible: bool
) -> None:
    running = begin(alone, database, preemptible=preemptible)
    add(alone, "ann")
    assert alone.make_room() == {}
    waiting = add(alone, "ben")
    assert alone.make_room() == ({waiting.id: [running.job_id]} if preemptible else {})
    assert alone.rooms() == ({waiting.id: [f"job {running.job_id}"]} if preemptible else {})
    if preemptible:
        running.give_back(Reason.PREEMPTED, "It made room.")
        assert alone.rooms() == {}
        claims = [take(alone) for _ in range(2)]
        # The one that made room comes after; Ann's oldest comes before her next.
        assert [claim.job_id for claim in claims if claim] == [waiting.id, running.job_id]


def _is(job_id: str) -> Callable[[Job], bool]:
    return lambda job: job.id == job_id


def pass_time(database: Database, seconds: float) -> None:
    database.change("UPDATE jobs SET room_asked_at = room_asked_at - %s", timedelta(seconds=seconds))


def test_who_does_not_drain_is_not_waited_for(alone: PostgresJobStore, database: Database) -> None:
    """A worker of an older version does not hear that it is to make room."""
    deaf = begin(alone, database, priority="low")
    high = add(alone, "ben", priority="high")
    assert alone.make_room() == {high.id: [deaf.job_id]}
    other = WorkerInfo.model_validate({**alone.workers()[0].model_dump(), "name": "host:cpu:00000b"})
    alone.announce(other, timedelta(seconds=40))
    second = add(alone, "ann", priority="low")
    take(alone, fits=_is(second.id))
    database.change("UPDATE attempts SET worker = %s WHERE job_id = %s", other.name, second.id)
    pass_time(database, DRAINED_WITHIN_S - 5)
    assert alone.make_room() == {}
    pass_time(database, 5)
    assert not any(one.yields_to for one in alone.turn_facts().started)
    assert alone.make_room() == {high.id: [second.id]}


def test_if_another_took_the_slot_the_next_ones_are_asked_after_a_while(
    job_store: PostgresJobStore, low: Claim, database: Database
) -> None:
    high = add(job_store, "ben", priority="high")
    assert job_store.make_room() == {high.id: [low.job_id]}
    low.give_back(Reason.PREEMPTED, "It made room.")
    assert take(job_store, fits=_is(low.job_id)) is not None
    assert job_store.make_room() == {}
    pass_time(database, ASKED_AGAIN_S)
    assert job_store.make_room() == {high.id: [low.job_id]}


def test_a_job_that_cannot_be_resolved_gets_no_room_and_stops_nothing(
    job_store: PostgresJobStore, low: Claim, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chore that makes room also watches the leases."""
    high = add(job_store, "ben", priority="high")

    def fail(job: Job, workers: object) -> None:
        raise KeyError(job.id)

    with monkeypatch.context() as patch:
        patch.setattr("core.adapters.postgres.preemption.able_to_run", fail)
        assert job_store.make_room() == {}
    assert job_store.make_room() == {high.id: [low.job_id]}


def test_a_job_to_which_somebody_refers_is_claimed(job_store: PostgresJobStore, database_url: str) -> None:
    """A transaction that adds a row of another table locks the job as a foreign key does."""
    job = add(job_store)
    with psycopg.connect(database_url) as other:
        other.execute("SELECT FROM jobs WHERE id = %s FOR KEY SHARE", [job.id])
        claim = take(job_store)
    assert claim is not None
    assert claim.job_id == job.id
