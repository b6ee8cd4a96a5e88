"""Which job a worker gets, in the real record; and that none is lost or claimed twice."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta
from itertools import count
from typing import Any

import pytest
import redis
from psycopg.errors import DivisionByZero, UndefinedTable
from sqlalchemy import Connection, text

from core.accounts.store import Actor
from core.adapters.postgres import turns
from core.adapters.postgres.engine import DriverStatement, connect_postgres
from core.adapters.postgres.rows import find_job
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.postgres.turns import running_query
from core.adapters.rq.queue import RQQueue
from core.jobs.attempts import Claim, claim_turn, new_secret
from core.jobs.job import Job, UnreadableJob
from core.jobs.pools import NothingFits, Offer
from core.jobs.queue import queue_name, queue_names
from core.jobs.reconciliation import Reconciler
from core.jobs.sharing import GIB
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.turns import Quota
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.contract.recording import LEASE, NOW, Database, cancelled, taken_back
from tests.in_memory import MemoryJobQueue, MemoryObjectStore

_NUMBERS = count()


def add(store: PostgresJobStore, owner: str | None = None, project: str = "default", **fields: object) -> Job:
    """A job that is younger than those before."""
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
    job_id = f"{next(_NUMBERS):012x}-0000000000"
    return store.add(Job(id=job_id, spec=spec, created_at=NOW, owner=owner, project=project))


def take(store: PostgresJobStore, device: str = "cpu", secret: str = "", **more: object) -> Claim | None:
    return claim_turn(
        queue_names(device),
        f"host:{device}:00000a",
        store=store,
        objects=MemoryObjectStore(),
        lease=LEASE,
        secret=secret or new_secret(),
        **more,  # type: ignore[arg-type]
    )


def taken(store: PostgresJobStore, number: int, device: str = "cpu") -> list[str]:
    claims = [take(store, device) for _ in range(number)]
    return [claim.job_id for claim in claims if claim is not None]


def test_jobs_of_one_user_are_claimed_by_priority_and_then_by_age(job_store: PostgresJobStore) -> None:
    low, first, second = add(job_store, priority="low"), add(job_store), add(job_store)
    high = add(job_store, priority="high")
    assert taken(job_store, 5) == [high.id, first.id, second.id, low.id]


def test_a_slot_gets_only_jobs_of_its_kind(job_store: PostgresJobStore) -> None:
    on_gpu, on_two = add(job_store, resources={"gpus": 1}), add(job_store, resources={"gpus": 2})
    anywhere = add(job_store)
    assert taken(job_store, 2) == [anywhere.id]
    assert taken(job_store, 2, "gpu:0,1") == [on_two.id]
    assert taken(job_store, 2, "gpu:0") == [on_gpu.id]


def test_a_pool_gives_a_job_its_gpus_and_says_which(job_store: PostgresJobStore) -> None:
    seen: Any = {"queues": queue_names("gpu:0", pool=4), "started_at": NOW, "seen_at": NOW}
    four, two = (add(job_store, resources={"gpus": gpus}) for gpus in (4, 2))
    objects = MemoryObjectStore()
    workers = [
        WorkerInfo(name=f"w{n}", host="host", pid=n, device=f"gpu:{n}", pool="gpu:0,1,2,3", **seen)
        for n in range(4)
    ]
    offer = Offer("host/gpu:0,1,2,3", 2, frozenset({0, 1, 2, 3}), workers)

    def take_of_pool(offer: Offer, secret: str = "", **more: Any) -> Claim | None:
        secret = secret or new_secret()
        stores: Any = {"store": job_store, "objects": objects}
        queues = queue_names("gpu:2", pool=4)
        return claim_turn(
            queues, "host:gpu:2:00000a", **stores, lease=LEASE, secret=secret, offer=offer, **more
        )

    def fits_none(job: Job) -> bool:
        return False

    with pytest.raises(NothingFits, match=f"{four.id} comes first, and needs 4 GPUs; 2 are free here"):
        take_of_pool(replace(offer, free=frozenset({2, 3})))
    # Nothing is kept for jobs that this machine cannot run.
    assert take_of_pool(replace(offer, free=frozenset({2})), fits=fits_none) is None
    first, again = take_of_pool(offer, "ab" * 8), take_of_pool(offer, "ab" * 8)
    assert first == again
    assert first is not None
    assert (first.job_id, first.device) == (four.id, "gpu:0,1,2,3")
    assert [one.num_gpus for one in job_store.numbers().running] == [4]
    first.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    second = take_of_pool(replace(offer, free=frozenset({2, 3})))
    assert second is not None
    assert (second.job_id, second.device) == (two.id, "gpu:2,3")
    assert take_of_pool(offer) is None


def test_a_job_that_shares_a_gpu_gets_what_was_measured_of_jobs_like_it(job_store: PostgresJobStore) -> None:
    """The first has a GPU of 16 GiB alone and takes 4 GiB, as is known when it has succeeded: the next has
    5 GiB, and one that asks for 2 GiB has these. When 5 GiB were too few, the fourth has a GPU alone."""
    workers = [
        WorkerInfo.model_validate(
            {
                "name": f"host:gpu:0:00000{seat}",
                "host": "host",
                "pid": 1,
                "device": "gpu:0",
                "pool": "gpu:0",
                "queues": queue_names("gpu:0"),
                "seats": 2,
                "seat": seat,
                "memory_bytes": 16 * GIB,
                "started_at": NOW,
                "seen_at": NOW,
            }
        )
        for seat in (0, 1)
    ]
    asked = {"share_gpu": True}
    first, second = add(job_store, resources=asked), add(job_store, resources=asked)
    offer = Offer("host/gpu:0", 0, frozenset({0}), workers)
    alone = take(job_store, "gpu:0", offer=offer)
    assert alone is not None
    assert (alone.job_id, alone.device, alone.gpu_part) == (first.id, "gpu:0", None)
    joins = replace(offer, free=frozenset(), parts=[5 / 16])
    for num_bytes in (GIB, 4 * GIB):  # The first evaluation comes after the first update.
        assert alone.note_peak(num_bytes).attempts[-1].peak_bytes == num_bytes
        with pytest.raises(NothingFits, match=second.id):
            take(job_store, "gpu:0", offer=joins)
    alone.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    third = add(job_store, resources={**asked, "gpu_memory_gib": 2})
    shared = take(job_store, "gpu:0", offer=offer)
    assert shared is not None
    assert (shared.job_id, shared.device, shared.gpu_part) == (second.id, "gpu:0", 5 / 16)
    beside = take(job_store, "gpu:0", offer=joins)
    assert beside is not None
    assert (beside.job_id, beside.gpu_part) == (third.id, 2 / 16)
    started = {one.id: one.part for one in job_store.turn_facts().started}
    assert started == {second.id: 5 / 16, third.id: 2 / 16}
    assert [one.num_gpus for one in job_store.numbers().running] == pytest.approx([5 / 16, 2 / 16])
    fourth = add(job_store, resources=asked)
    shared.end(JobStatus.FAILED, Reason.OUT_OF_MEMORY, "")
    measured = take(job_store, "gpu:0", offer=offer)
    assert measured is not None
    assert (measured.job_id, measured.gpu_part) == (fourth.id, None)


def test_users_take_turns_and_what_they_used_is_remembered(
    job_store: PostgresJobStore, database: Database
) -> None:
    ann = [add(job_store, "ann") for _ in range(3)]
    ben = add(job_store, "ben")
    claims = [take(job_store) for _ in range(2)]
    assert [claim.job_id for claim in claims if claim] == [ann[0].id, ben.id]
    database.change("UPDATE attempts SET started_at = started_at - interval '2 h' WHERE job_id = %s", ben.id)
    for claim in claims:
        assert claim is not None
        claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    add(job_store, "ben")
    assert taken(job_store, 2) == [ann[1].id, ann[2].id]


def test_use_is_halved_every_half_life_and_added_up(job_store: PostgresJobStore, database: Database) -> None:
    """An hour on two GPUs three days ago, and half an hour on one now: 3,600 + 1,800 GPU-seconds."""
    job_store.beat(LEASE)
    for gpus, hours, device in ((2, 1.0, "gpu:0,1"), (1, 0.5, "gpu:0")):
        add(job_store, "ann", resources={"gpus": gpus})
        claim = take(job_store, device)
        assert claim is not None
        begun = timedelta(hours=hours)
        database.change(
            "UPDATE attempts SET started_at = clock_timestamp() - %s WHERE ended_at IS NULL", begun
        )
        claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
        if gpus == 2:
            database.change("UPDATE shares SET at = at - interval '3 days'")
    (share,) = job_store.turn_facts().shares
    assert (share.device, share.who) == ("gpu", ("default", "ann"))
    assert share.amount == pytest.approx(5400, rel=1e-3)
    # Half of an hour's attempt and a whole one of half an hour.
    assert share.usual_s == pytest.approx((3600 / 2 + 1800) / 1.5, rel=1e-3)


def test_another_half_life_acts_on_what_comes_and_not_on_what_has_passed(
    job_store: PostgresJobStore, database: Database
) -> None:
    """Of 3,600 s half is left after three days, and of that half after a day more: 900."""
    job_store.beat(LEASE)
    add(job_store, "ann")
    claim = take(job_store)
    assert claim is not None
    database.change("UPDATE attempts SET started_at = clock_timestamp() - interval '1 h'")
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    for days in (3, 1):
        database.change("UPDATE shares SET at = at - %s", timedelta(days=days))
        for _ in range(2):
            job_store.set_half_life(timedelta(days=1))
    (share,) = job_store.turn_facts().shares
    assert share.amount == pytest.approx(900, rel=1e-3)
    assert share.usual_s == pytest.approx(3600, rel=1e-3)


def test_as_many_jobs_run_as_the_quota_says(job_store: PostgresJobStore) -> None:
    jobs = [add(job_store, "ann") for _ in range(3)]
    job_store.set_quota("user", "ann", Quota(running=1), Actor())
    assert job_store.quotas().of("user", "ann") == Quota(running=1)
    first = take(job_store)
    assert first is not None
    assert take(job_store) is None
    assert job_store.waiting() == []  # The reconciler sends no message for what may not begin.
    first.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "")
    assert [dispatch.subject for dispatch in job_store.waiting()] == [job.id for job in jobs[1:]]
    assert taken(job_store, 1) == [jobs[1].id]


def test_a_job_that_the_worker_cannot_run_is_passed_over(job_store: PostgresJobStore) -> None:
    jobs = [add(job_store) for _ in range(3)]

    def fits(job: Job) -> bool:
        return job.id == jobs[2].id

    claim = take(job_store, fits=fits)
    assert claim is not None
    assert claim.job_id == jobs[2].id


@pytest.mark.parametrize("most", [100, 5])
def test_many_jobs_that_the_worker_cannot_run_keep_no_other_user_waiting(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    monkeypatch.setattr("core.adapters.postgres.turns._MOST_UNFIT", most)
    for _ in range(12):
        add(job_store, "ann")
    bens, tried = add(job_store, "ben"), list[str | None]()

    def fits(job: Job) -> bool:
        tried.append(job.owner)
        return job.owner == "ben"

    claim = take(job_store, fits=fits)
    assert claim is not None
    assert claim.job_id == bens.id
    assert tried == ["ann"] * min(10, most) + ["ben"]


def test_a_job_that_is_cancelled_deleted_or_claimed_meanwhile_is_passed_over(
    job_store: PostgresJobStore,
) -> None:
    cancels, deletes, claims, last = (add(job_store) for _ in range(4))

    def fits(job: Job) -> bool:
        if job.id == cancels.id:
            job_store.save(cancelled(job))
        elif job.id == deletes.id:
            job_store.delete(job.id, job.version)
        elif job.id == claims.id:
            job_store.save(job.claimed("worker-2", NOW), lease=LEASE)
        return True

    claim = take(job_store, fits=fits)
    assert claim is not None
    assert claim.job_id == last.id
    assert job_store.get(last.id).token == claim.token


def test_running_jobs_are_found_by_an_index_among_many_others(
    job_store: PostgresJobStore, database: Database
) -> None:
    add(job_store)
    database.change(
        """
        INSERT INTO jobs (id, version, kind, environment, labels, spec, status, created_at)
        SELECT id || n, version, kind, environment, labels, spec,
            CASE mod(n, 2) WHEN 0 THEN 'queued' ELSE 'succeeded' END, created_at
        FROM jobs, generate_series(10001, 20000) AS n
        """
    )
    database.change("ANALYZE jobs")
    database.change("SET enable_sort = off")
    running = running_query("yields_to").replace(":held", "'{starting,running,cancelling}'")
    plan = str(database.read(f"EXPLAIN {running}"))
    assert "jobs_by_status" in plan, plan


@pytest.mark.parametrize("isolation", ["AUTOCOMMIT", "READ COMMITTED"])
def test_the_settings_of_a_statement_are_gone_with_its_transaction(database_url: str, isolation: str) -> None:
    shown = text("SELECT current_setting('enable_sort') AS sort")
    unsorted = DriverStatement(shown, "SELECT set_config('enable_sort', 'off', true)")
    engine = connect_postgres(database_url, pool_size=1).execution_options(isolation_level=isolation)
    with engine.begin() as connection:
        assert unsorted.rows(connection, {}) == [{"sort": "off"}]
    with engine.begin() as connection:
        assert DriverStatement(shown).rows(connection, {}) == [{"sort": "on"}]
    engine.dispose()


@pytest.mark.parametrize("isolation", ["AUTOCOMMIT", "READ COMMITTED"])
@pytest.mark.parametrize("fails", ["SELECT 1 / 0", "SELECT * FROM missing"])
@pytest.mark.parametrize("are_settings", [False, True])
def test_a_statement_that_fails_leaves_its_connection_fit_for_others(
    database_url: str, isolation: str, fails: str, are_settings: bool
) -> None:
    works = DriverStatement(text("SELECT 2 AS two"), "SELECT 3")
    failing = (
        DriverStatement(text("SELECT 1"), fails) if are_settings else DriverStatement(text(fails), "SELECT 3")
    )
    engine = connect_postgres(database_url, pool_size=1).execution_options(isolation_level=isolation)
    servers = set[int]()
    for _ in range(2):
        with pytest.raises((DivisionByZero, UndefinedTable)), engine.begin() as connection:
            failing.rows(connection, {})
        with engine.begin() as connection:
            assert works.rows(connection, {}) == [{"two": 2}]
            servers.add(connection.execute(text("SELECT pg_backend_pid()")).scalar_one())
    assert len(servers) == 1
    engine.dispose()


def test_a_claim_whose_answer_was_lost_is_the_same_again(job_store: PostgresJobStore) -> None:
    add(job_store)
    add(job_store)
    first, again = take(job_store, secret="ab" * 8), take(job_store, secret="ab" * 8)
    assert first is not None
    assert again is not None
    assert (again.job_id, again.token) == (first.job_id, first.token)


def test_a_claim_whose_answer_was_lost_and_that_ended_meanwhile_is_another_one(
    job_store: PostgresJobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = add(job_store), add(job_store)
    take(job_store, secret="mine")

    def after_it_was_taken_back(connection: Connection, job_id: str) -> Job | UnreadableJob:
        job = job_store.get(job_id)
        if job_id == first.id and job.token:
            job_store.save(taken_back(job))
        return find_job(connection, job_id)

    monkeypatch.setattr(turns, "find_job", after_it_was_taken_back)
    claim = take(job_store, secret="mine")
    assert claim is not None
    assert (claim.job_id, claim.token) == (second.id, "1-mine")
    assert job_store.get(first.id).status == JobStatus.QUEUED


def test_of_many_who_ask_at_once_each_gets_another_job(job_store: PostgresJobStore) -> None:
    jobs = [add(job_store, f"u{number % 3}") for number in range(12)]
    with ThreadPoolExecutor(8) as pool:
        claims = [one.result() for one in [pool.submit(take, job_store) for _ in range(16)]]
    found = [claim.job_id for claim in claims if claim is not None]
    assert sorted(found) == sorted(job.id for job in jobs)


def test_a_row_of_an_older_version_without_a_queue_is_claimed_by_its_message(
    job_store: PostgresJobStore, database: Database
) -> None:
    job = add(job_store)
    database.change("UPDATE jobs SET queue = NULL")
    assert take(job_store) is None
    claim = take(job_store, told=job.id)
    assert claim is not None


def test_a_job_whose_message_another_one_was_claimed_by_gets_a_second_message(
    job_store: PostgresJobStore, redis_client: redis.Redis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker takes the message of the second job and claims the first one, whose message is lost."""
    first, second = add(job_store), add(job_store)
    queue, name = RQQueue(redis_client), queue_name("any", "normal")
    queue.enqueue(second.id, 1, name=name)
    redis_client.lpop(f"rq:queue:{name}")
    redis_client.zadd(f"rq:wip:{name}", {f"{second.id}_1:execution": "inf"})
    redis_client.zadd(f"rq:executions:{second.id}_1", {"execution": "inf"})
    assert taken(job_store, 1) == [first.id]
    assert (queue.known(), queue.taken()) == ({(second.id, 1)}, {(second.id, 1)})
    reconciler = Reconciler(job_store, queue, LEASE)
    assert [reconciler.run_once() for _ in range(3)] == [0, 0, 0]
    monkeypatch.setattr("core.jobs.reconciliation._CLAIMED_WITHIN_S", 0.0)
    assert [reconciler.run_once() for _ in range(3)] == [1, 0, 0]
    assert queue.num_waiting([name]) == {name: 1}
    assert (queue.known(), queue.taken()) == ({(second.id, 1)}, set())


def test_in_memory_too_a_message_comes_again() -> None:
    queue, name = MemoryJobQueue(), queue_name("any", "normal")
    queue.enqueue("a", 1, name=name)
    queue.take()
    assert queue.taken() == {("a", 1)}
    queue.enqueue("a", 1, name=name, again=True)
    assert (queue.taken(), queue.num_waiting([name])) == (set(), {name: 1})


def test_a_job_that_another_claim_is_about_to_take_is_passed_over_without_waiting(
    job_store: PostgresJobStore, database_url: str
) -> None:
    first, second = add(job_store), add(job_store)
    engine = connect_postgres(database_url)
    with engine.begin() as other:
        other.execute(text("SELECT 1 FROM jobs WHERE id = :id FOR UPDATE"), {"id": first.id})
        assert taken(job_store, 2) == [second.id]
    engine.dispose()
    assert taken(job_store, 2) == [first.id]
