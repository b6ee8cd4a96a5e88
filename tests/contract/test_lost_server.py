"""What the record says while PostgreSQL is away or silent, and that it resumes when PostgreSQL is back."""

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import timedelta
from functools import partial
from pathlib import Path
from threading import Barrier

import psutil
import pytest

from core.accounts.principal import NOBODYS
from core.accounts.store import Actor
from core.adapters.postgres import schema
from core.adapters.postgres.engine import DEADLINE_S, connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.errors import RecordsRefuse, RecordsUnavailable
from core.jobs.job import Job
from core.jobs.patch import JobPatch
from core.jobs.quotas import QuotaStore
from core.jobs.retention import Choice, EndedJob, Removal, Retention, RetentionRules, RetentionStore
from core.jobs.status import JobStatus
from core.jobs.store import Chunk, Dispatch, Idempotency, JobQuery, JobStore
from core.jobs.tallies import Tally
from core.jobs.turns import Quota
from core.jobs.usage import UsageStore
from core.jobs.workers import WorkerStore
from core.uploads.record import UploadStore
from gaitway.service.embedded.postgres import Postgres
from tests.contract.recording import (
    LEASE,
    MODEL,
    NOW,
    held,
    line,
    model,
    queued_job,
    taken_back,
    worker,
)

Call = Callable[[JobStore], object]
# The deadline of a call, and something for a busy machine: less than two of them.
PROMPT_S = 3.8
RULES = RetentionRules(checkpoints=1)
BY = Retention(project="default", rules=RULES, set_at=NOW)
CHOICE = Choice(("video",), 1)
REMOVAL = Removal(EndedJob("a", 1, None, None, JobStatus.FAILED, NOW), {})
CHUNK = Chunk("logs", 1, 1, "chunk", size=1, sha256="0" * 64)


def calls(job: Job) -> Mapping[str, Call]:
    """One call of each method."""
    return {
        "now": lambda jobs: jobs.now(),
        "add": lambda jobs: jobs.add(queued_job()),
        "import_job": lambda jobs: jobs.import_job(job, [], []),
        "remembered": lambda jobs: jobs.remembered(Idempotency("k", "b")),
        "find": lambda jobs: jobs.find(job.id),
        "get": lambda jobs: jobs.get(job.id),
        "save": lambda jobs: jobs.save(job.running()),
        "patch": lambda jobs: jobs.patch(job.id, JobPatch(name="a gait")),
        "take_back": lambda jobs: jobs.take_back(taken_back(job)),
        "delete": lambda jobs: jobs.delete(job.id, job.version),
        "deletions": lambda jobs: jobs.deletions(),
        "deletion_ended": lambda jobs: jobs.deletion_ended(job.id),
        "list": lambda jobs: jobs.list(JobQuery()),
        "expired": lambda jobs: list(jobs.expired()),
        "beat": lambda jobs: jobs.beat(LEASE),
        "models.rename": lambda jobs: jobs.models.rename(MODEL, "a dog"),
        "waiting": lambda jobs: jobs.waiting(),
        "take_turn": lambda jobs: jobs.take_turn(["q"], "w", lease=LEASE, secret="s"),
        "make_room": lambda jobs: jobs.make_room(),
        "rooms": lambda jobs: jobs.rooms(),
        "turn_facts": lambda jobs: jobs.turn_facts(),
        "keep_peak": lambda jobs: jobs.keep_peak("like", 1),
        "forget_peak": lambda jobs: jobs.forget_peak("like"),
        "quotas": lambda jobs: jobs.quotas(),
        "quota_uses": lambda jobs: jobs.quota_uses(),
        "set_quota": lambda jobs: jobs.set_quota("user", "ann", Quota(), Actor()),
        "remove_quota": lambda jobs: jobs.remove_quota("user", "ann", Actor()),
        "queue_counts": lambda jobs: jobs.queue_counts(),
        "numbers": lambda jobs: jobs.numbers(),
        "usage": lambda jobs: jobs.usage(NOW),
        "set_half_life": lambda jobs: jobs.set_half_life(LEASE),
        "add_tallies": lambda jobs: jobs.add_tallies([Tally("s", (), (), 1.0)]),
        "jobs_of": lambda jobs: jobs.jobs_of([job.id]),
        "undispatched": lambda jobs: jobs.undispatched(),
        "dispatched": lambda jobs: jobs.dispatched([Dispatch("attempt", job.id, 1)]),
        "renew": lambda jobs: jobs.renew(job.id, job.token, LEASE),
        "record": lambda jobs: jobs.record(job.id, job.token, "logs", [line("a")], write_id="w"),
        "feed": lambda jobs: jobs.feed(job.id, "logs"),
        "feed_metrics": lambda jobs: jobs.feed_metrics(job.id),
        "long_feeds": lambda jobs: jobs.long_feeds(max_bytes=1, max_age=LEASE, max_metrics_bytes=1),
        "oldest_entries": lambda jobs: jobs.oldest_entries(job.id, "logs", limit=1),
        "oldest_metrics": lambda jobs: jobs.oldest_metrics(job.id),
        "replace_by_chunk": lambda jobs: jobs.replace_by_chunk(job.id, CHUNK),
        "chunks": lambda jobs: jobs.chunks([job.id]),
        "replace_chunk": lambda jobs: jobs.replace_chunk(job.id, CHUNK, CHUNK),
        "marks": lambda jobs: jobs.marks([job.id]),
        "jobs_needing_checkpoint_of": lambda jobs: jobs.jobs_needing_checkpoint_of(job.id),
        "retention": lambda jobs: jobs.retention("default"),
        "retentions": lambda jobs: jobs.retentions(),
        "set_retention": lambda jobs: jobs.set_retention("default", RULES, Actor()),
        "end_retention": lambda jobs: jobs.end_retention("default", Actor()),
        "ended_jobs": lambda jobs: jobs.ended_jobs("default"),
        "files_of_ended": lambda jobs: jobs.files_of_ended([job.id], CHOICE),
        "sums_of_ended": lambda jobs: jobs.sums_of_ended([job.id], CHOICE),
        "checkpoint_needs": lambda jobs: jobs.checkpoint_needs("default"),
        "remove_retained": lambda jobs: jobs.remove_retained(REMOVAL, BY),
        "objects_named": lambda jobs: jobs.objects_named([job.id]),
        "announce": lambda jobs: jobs.announce(worker("a"), LEASE),
        "withdraw": lambda jobs: jobs.withdraw("a"),
        "workers": lambda jobs: jobs.workers(),
        "list_workers": lambda jobs: jobs.list_workers(),
        "tidy": lambda jobs: jobs.tidy(),
        "ping": lambda jobs: jobs.ping(),
        "models.find": lambda jobs: jobs.models.find(MODEL),
        "models.add": lambda jobs: jobs.models.add(model()),
        "models.dispatched": lambda jobs: jobs.models.dispatched(MODEL),
        "models.settle": lambda jobs: jobs.models.settle(model()),
        "models.delete": lambda jobs: jobs.models.delete(MODEL),
        "models.num_waiting": lambda jobs: jobs.models.num_waiting(),
        "models.all": lambda jobs: jobs.models.all(),
        "models.list": lambda jobs: jobs.models.list(),
        "queues_of_several_hosts": lambda jobs: jobs.queues_of_several_hosts(),
        "owner_of": lambda jobs: jobs.owner_of(job.id),
        "models.claim": lambda jobs: jobs.models.claim(MODEL, NOBODYS),
        "models.owners_of": lambda jobs: jobs.models.owners_of([MODEL]),
        "models.release": lambda jobs: jobs.models.release(MODEL, ["default"]),
    }


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Postgres]:
    """A PostgreSQL of the test's own."""
    with Postgres(tmp_path / "postgres", durable=False) as server:
        schema.upgrade(connect_postgres(server.url, pool_size=0))
        yield server


@pytest.fixture
def jobs(server: Postgres) -> Iterator[PostgresJobStore]:
    # Its clock, too, asks the server at each call.
    jobs = PostgresJobStore(connect_postgres(server.url), clock_age=timedelta(0))
    yield jobs
    jobs.close()


@contextmanager
def silenced(server: Postgres) -> Iterator[None]:
    """Meanwhile it takes connections, and answers nobody."""
    assert server.process.pid is not None
    leader = psutil.Process(server.process.pid)
    # First the one that would start others.
    leader.suspend()
    everyone = [leader, *leader.children(recursive=True)]
    for process in everyone:
        process.suspend()
    try:
        yield
    finally:
        for process in everyone:
            process.resume()


def refusal(call: Callable[[], object]) -> tuple[str, float]:
    """The call's error, and after how many seconds it came."""
    begun = time.monotonic()
    with pytest.raises(RecordsUnavailable, match="GAITWAY_DATABASE_URL") as caught:
        call()
    assert not isinstance(caught.value, RecordsRefuse)
    return caught.value.detail, time.monotonic() - begun


def eventually(call: Callable[[], object]) -> object:
    """The call's result as soon as the record can be reached."""
    until = time.monotonic() + 10
    while True:
        try:
            return call()
        except RecordsUnavailable:
            if time.monotonic() > until:
                raise
            time.sleep(0.02)


def test_every_method_of_the_record_is_called_here() -> None:
    kinds = (JobStore, QuotaStore, RetentionStore, UsageStore, WorkerStore)
    methods = {name for kind in kinds for name in vars(kind) if not name.startswith("_")}
    methods |= {f"models.{name}" for name in vars(UploadStore) if not name.startswith("_") and name != "kind"}
    assert methods == set(calls(queued_job().claimed("w", queued_job().created_at)))


def test_every_call_says_at_once_that_the_server_is_gone(server: Postgres, jobs: PostgresJobStore) -> None:
    job = held(jobs, queued_job())
    server.stop()
    for call in calls(job).values():
        said, seconds = refusal(partial(call, jobs))
        assert seconds < PROMPT_S
        assert said.endswith("Start it, or correct the setting.")


@pytest.mark.parametrize("has_connection", [True, False])
def test_every_call_says_within_seconds_that_the_server_is_silent(
    has_connection: bool, server: Postgres, jobs: PostgresJobStore
) -> None:
    job = held(jobs, queued_job())
    everything = calls(job)
    stores = [PostgresJobStore(connect_postgres(server.url, pool_size=1)) for _ in everything]
    if has_connection:
        for store in stores:
            store.ping()
    together = Barrier(len(stores))

    def wait_for(store: JobStore, call: Call) -> float:
        together.wait()
        return refusal(partial(call, store))[1]

    with ThreadPoolExecutor(len(stores)) as pool, silenced(server):
        took = list(pool.map(wait_for, stores, everything.values()))
    assert {name: seconds for name, seconds in zip(everything, took, strict=True) if seconds > PROMPT_S} == {}
    assert jobs.get(job.id) == job
    for store in stores:
        store.close()


def test_after_a_silence_others_are_told_at_once(server: Postgres, jobs: PostgresJobStore) -> None:
    jobs.ping()
    with silenced(server):
        said, _ = refusal(jobs.ping)
        assert refusal(jobs.ping)[1] < 0.5 * DEADLINE_S
        assert refusal(jobs.workers) == (said, pytest.approx(0, abs=0.5 * DEADLINE_S))


def test_a_server_that_falls_silent_in_a_transaction_is_given_up(
    server: Postgres, jobs: PostgresJobStore
) -> None:
    def call() -> None:
        with jobs._transaction() as connection, silenced(server):
            connection.exec_driver_sql("SELECT 1")

    jobs.ping()
    said, seconds = refusal(call)
    assert ("no answer within 2 s" in said, seconds < PROMPT_S) == (True, True)
    eventually(jobs.ping)


def test_it_resumes_when_the_server_is_back(server: Postgres, jobs: PostgresJobStore) -> None:
    job = held(jobs, queued_job())
    jobs.record(job.id, job.token, "logs", [line("before")], write_id="1")
    with jobs._transaction(), jobs._transaction(), jobs._transaction():
        pass
    server.stop()
    server.start()
    # The three connections that the pool keeps are dead.
    assert jobs.get(job.id) == job
    jobs.record(job.id, job.token, "logs", [line("after")], write_id="2")
    assert [entry.data["text"] for entry in jobs.feed(job.id, "logs").entries] == ["before", "after"]


def test_it_resumes_after_a_silence(server: Postgres, jobs: PostgresJobStore) -> None:
    job = held(jobs, queued_job())
    with silenced(server):
        refusal(partial(jobs.get, job.id))
    assert eventually(partial(jobs.get, job.id)) == job
    # The silent connection did not go back into the pool: all that are there serve.
    with ThreadPoolExecutor(12) as pool:
        assert list(pool.map(jobs.get, [job.id] * 48)) == [job] * 48


def test_a_process_that_stood_still_in_a_transaction_is_told_so(jobs: PostgresJobStore) -> None:
    def stand_still() -> None:
        """As a process that was stopped and continued, or a virtual machine that was moved."""
        with jobs._transaction() as connection:
            connection.exec_driver_sql("SET LOCAL idle_in_transaction_session_timeout = 50")
            pid = connection.exec_driver_sql("SELECT pg_backend_pid()").scalar_one()
            psutil.wait_procs([psutil.Process(pid)], timeout=10)
            connection.exec_driver_sql("SELECT 1")

    with pytest.raises(RecordsUnavailable, match="a transaction that was idle"):
        stand_still()
    jobs.ping()


def test_more_callers_than_connections_wait_for_each_other_a_while(server: Postgres) -> None:
    jobs = PostgresJobStore(connect_postgres(server.url, pool_size=1))
    # One connection is kept, and two more may come.
    with jobs._transaction(), jobs._transaction(), jobs._transaction(), ThreadPoolExecutor(1) as pool:
        begun = time.monotonic()
        with pytest.raises(RecordsUnavailable, match="Too many calls wait"):
            pool.submit(jobs.ping).result()
        assert time.monotonic() - begun < PROMPT_S
    jobs.ping()
    jobs.close()
