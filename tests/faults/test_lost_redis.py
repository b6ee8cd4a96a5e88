"""Redis forgets everything, or is away: no accepted job is lost, none ends twice, no running one minds."""

import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
import redis
from pydantic import SecretStr
from structlog.testing import capture_logs

from core.adapters.postgres.store import PostgresJobStore
from core.adapters.rq.queue import RQQueue
from core.adapters.wiring import connect_redis
from core.errors import RecordsUnavailable
from core.jobs.attempts import Claim, claim_attempt, new_secret
from core.jobs.ending import cancel
from core.jobs.job import Job
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch, Entry
from core.reasons import Reason
from core.settings import WorkerSettings
from gaitway.service.embedded.valkey import Valkey
from tests.contract.recording import Database, watch
from tests.faults.bench import wait_until
from tests.faults.outages import NullWorker, submitted
from tests.feeds import read_feed
from tests.in_memory import MemoryObjectStore
from tests.unit.worker.environments import environment
from worker.main import GaitwayWorker

LEASE = timedelta(seconds=15)


class Service:
    """The record, one Redis, a reconciler that looks when it is told to, and a worker."""

    def __init__(self, store: PostgresJobStore, client: redis.Redis) -> None:
        self.store, self.client, self.objects = store, client, MemoryObjectStore()
        self.queue = RQQueue(client)
        self.reconciler = Reconciler(store, self.queue, LEASE)
        self.worker = NullWorker(store, self.objects, client)

    def submit(self) -> Job:
        return submitted(self.store, self.queue)

    def claim(self, job: Job) -> Claim:
        claim = claim_attempt(
            job.id, 1, "w", store=self.store, objects=self.objects, lease=LEASE, secret=new_secret()
        )
        assert claim is not None
        return claim

    def run_once(self, times: int = 2) -> int:
        """How much was set right; what the queue forgot is handed over at the second look that misses it."""
        return sum(self.reconciler.run_once() for _ in range(times))

    def events(self, job: Job) -> list[Entry]:
        return list(read_feed(job.id, "events", store=self.store, objects=self.objects))


@pytest.fixture
def service(job_store: PostgresJobStore, redis_client: redis.Redis) -> Service:
    return Service(job_store, redis_client)


@pytest.fixture
def own_valkey(tmp_path: Path) -> Iterator[Valkey]:
    """One that a test may stop."""
    with Valkey(tmp_path / "valkey") as valkey:
        yield valkey


@pytest.fixture
def away(job_store: PostgresJobStore, own_valkey: Valkey) -> Iterator[Service]:
    """A service whose Redis is away, until the test starts `own_valkey`."""
    with connect_redis(own_valkey.url, retries=0) as client:
        own_valkey.stop()
        yield Service(job_store, client)


def test_a_job_is_accepted_while_something_else_writes_into_redis(service: Service) -> None:
    service.client.set("rq:queue:gaitway-any-normal", "no list")
    with capture_logs() as said:
        job = service.submit()
    assert [line["event"] for line in said] == ["job_submitted", "dispatch_postponed"]
    assert "WRONGTYPE" in said[1]["error"]
    assert service.store.get(job.id).status == JobStatus.QUEUED
    for _ in range(2):  # The reconciler says so at each look, and lives on.
        with pytest.raises(RecordsUnavailable, match="WRONGTYPE"):
            service.reconciler.run_once()
    service.client.flushdb()  # As the sentence advises.
    service.run_once()
    assert service.queue.contains(job.id, 1)


def test_a_job_is_accepted_when_redis_refuses_it_in_words_that_nobody_knows(
    service: Service, valkey: Valkey
) -> None:
    service.client.acl_setuser("guest", enabled=True, nopass=True, keys="*", categories=["+@all"])
    service.client.acl_setuser("guest", enabled=True, nopass=True, keys="*", commands=["-rpush"])
    try:
        with (
            connect_redis(valkey.url.replace("unix://", "unix://guest:any@")) as guest,
            capture_logs() as said,
        ):
            job = submitted(service.store, RQQueue(guest))
    finally:
        service.client.acl_deluser("guest")
    assert [line["event"] for line in said] == ["job_submitted", "dispatch_failed"]
    assert service.store.undispatched() == [Dispatch("attempt", job.id, 1)]
    service.run_once()
    assert service.queue.contains(job.id, 1)


def ended_once(service: Service, jobs: list[Job]) -> list[Job]:
    """Those that succeeded at their first attempt, and whose feed says so once."""
    return [job for job in jobs if statuses(service, job) == ["starting", "running", "succeeded"]]


def statuses(service: Service, job: Job) -> list[str]:
    return [entry.data["status"] for entry in service.events(job) if entry.kind == "status"]


def test_every_job_that_was_accepted_is_dispatched_again_and_ends_once(service: Service) -> None:
    jobs = [service.submit() for _ in range(50)]
    service.client.flushall()
    assert service.run_once(times=1) == 0  # A worker might be just taking them.
    assert service.run_once(times=1) == 50
    service.worker.work()
    assert ended_once(service, jobs) == jobs
    assert service.worker.claimed == {job.id: 1 for job in jobs}
    assert (service.run_once(), service.queue.known()) == (0, set())


@pytest.mark.extra
@pytest.mark.parametrize("seed", range(3))
def test_jobs_end_once_each_however_often_redis_forgets_while_they_come_and_go(
    seed: int, service: Service
) -> None:
    chance, jobs = random.Random(seed), list[Job]()
    while len(jobs) < 20:
        match chance.choice(["submit", "submit", "work", "look", "forget"]):
            case "submit":
                jobs.append(service.submit())
            case "work":
                service.worker.work(most=chance.randint(1, 3))
            case "look":
                service.reconciler.run_once()
            case _:
                service.client.flushall()
    service.run_once()
    service.worker.work()
    assert ended_once(service, jobs) == jobs
    assert service.worker.claimed == {job.id: 1 for job in jobs}


def test_nothing_changes_but_the_dispatch(service: Service) -> None:
    jobs = {
        name: service.submit()
        for name in ("queued", "running", "succeeded", "failed", "cancelled", "cancelling", "given back")
    }
    claims = {name: service.claim(job) for name, job in jobs.items() if name not in ("queued", "cancelled")}
    for claim in claims.values():
        claim.start()
    claims["succeeded"].end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.")
    claims["failed"].end(JobStatus.FAILED, Reason.DIVERGED, "The reward became non-finite.")
    claims["given back"].give_back(Reason.WORKER_DRAINED, "The worker was shut down.")
    for name in ("cancelled", "cancelling"):
        cancel(jobs[name].id, store=service.store, queue=service.queue)
    service.run_once()
    before = {name: (service.store.get(job.id), service.events(job)) for name, job in jobs.items()}

    service.client.flushall()
    assert service.run_once() == 2
    assert service.queue.known() == {(jobs["queued"].id, 1), (jobs["given back"].id, 2)}
    assert {name: (service.store.get(job.id), service.events(job)) for name, job in jobs.items()} == before
    # The attempts that hold their jobs do not even notice.
    for name in ("running", "cancelling"):
        claim = claims[name]
        assert service.store.renew(claim.job_id, claim.token, LEASE).status == name
    assert claims["running"].end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.").status == "succeeded"
    assert claims["cancelling"].give_back(Reason.WORKER_DRAINED, "Shut down.").status == "cancelled"


def test_a_restart_of_redis_loses_no_job(job_store: PostgresJobStore, own_valkey: Valkey) -> None:
    with connect_redis(own_valkey.url) as client:
        service = Service(job_store, client)
        jobs = [service.submit() for _ in range(5)]
        own_valkey.stop()
        own_valkey.start()
        assert client.keys() == []
        assert service.run_once() == 5
        service.worker.work()
        assert ended_once(service, jobs) == jobs


@pytest.mark.extra
def test_workers_at_an_old_redis_and_at_an_empty_new_one_do_no_job_twice(
    service: Service, own_valkey: Valkey
) -> None:
    jobs = [service.submit() for _ in range(10)]
    with connect_redis(own_valkey.url) as client:
        moved = Service(service.store, client)
        assert moved.run_once() == 10
        moved.worker.work(most=4)
        service.worker.work()  # It was not told of the new address.
        moved.worker.work()
    assert ended_once(service, jobs) == jobs
    assert (len(moved.worker.claimed), len(service.worker.claimed)) == (4, 6)


def test_what_is_submitted_while_redis_is_away_is_dispatched_when_it_is_back(
    away: Service, own_valkey: Valkey
) -> None:
    jobs = [away.submit() for _ in range(3)]
    assert [away.store.get(job.id).status for job in jobs] == ["queued"] * 3
    with pytest.raises(RecordsUnavailable, match="Redis does not answer"):
        away.run_once()
    own_valkey.start()
    assert away.run_once(times=1) == 3
    assert away.store.undispatched() == []
    away.worker.work()
    assert ended_once(away, jobs) == jobs


def test_a_cancel_needs_no_redis(away: Service, own_valkey: Valkey) -> None:
    queued, running = away.submit(), away.submit()
    away.claim(running).start()
    for job, status in ((queued, "cancelled"), (running, "cancelling")):
        assert cancel(job.id, store=away.store, queue=away.queue).status == status
    own_valkey.start()
    assert (away.run_once(), away.queue.known()) == (0, set())


def test_a_job_whose_worker_died_while_redis_was_away_is_dispatched_when_it_is_back(
    away: Service, own_valkey: Valkey, database: Database
) -> None:
    job = away.submit()
    away.claim(job)
    watch(away.store, database)
    database.end_lease(job)
    with pytest.raises(RecordsUnavailable):
        away.run_once(times=1)
    assert away.store.get(job.id).status == JobStatus.QUEUED
    own_valkey.start()
    assert away.run_once(times=1) == 1
    assert away.queue.known() == {(job.id, 2)}


@pytest.mark.extra
@pytest.mark.parametrize("is_away", [False, True])
def test_a_worker_ends_its_job_without_redis_and_takes_the_next_one_afterwards(
    is_away: bool, job_store: PostgresJobStore, settings: WorkerSettings, own_valkey: Valkey
) -> None:
    settings.data_dir.mkdir()
    command = [sys.executable, "-m", "tests.faults.probe_worker", "waits"]
    variables = environment(settings, GAITWAY_REDIS_URL=own_valkey.url, GAITWAY_DEVICE="cpu")
    with (
        connect_redis(own_valkey.url) as client,
        subprocess.Popen(command, env=variables, stdout=subprocess.DEVNULL) as worker,
    ):
        try:
            service = Service(job_store, client)
            first, second = service.submit(), service.submit()
            wait_until(lambda: job_store.get(first.id).newest("checkpoint") is not None, 30)
            if is_away:
                own_valkey.stop()
            else:
                client.flushall()
            cancel(first.id, store=job_store, queue=service.queue)
            wait_until(lambda: job_store.get(first.id).status.is_final, 30)
            if is_away:
                own_valkey.start()
            assert service.run_once() == 1
            wait_until(lambda: job_store.get(second.id).newest("checkpoint") is not None, 30)
            worker.send_signal(signal.SIGTERM)
            assert worker.wait(30) == 0
        finally:
            worker.kill()
    ended, given_back = job_store.get(first.id), job_store.get(second.id)
    assert (ended.status, len(ended.attempts)) == (JobStatus.CANCELLED, 1)
    assert [attempt.reason for attempt in given_back.attempts] == [Reason.WORKER_DRAINED]


@pytest.mark.extra
def test_a_worker_waits_for_a_full_redis_before_after_and_during_a_job(
    job_store: PostgresJobStore, settings: WorkerSettings, own_valkey: Valkey
) -> None:
    """H4: it ended at once, each time, so that the queue never emptied."""
    settings.data_dir.mkdir()
    command = [sys.executable, "-m", "tests.faults.probe_worker", "waits"]
    variables = environment(settings, GAITWAY_REDIS_URL=own_valkey.url, GAITWAY_DEVICE="cpu")
    with connect_redis(own_valkey.url) as client:
        service = Service(job_store, client)
        first = service.submit()
        make_full(client)
        second = service.submit()  # Accepted: the record has it.
        with subprocess.Popen(command, env=variables, stdout=subprocess.DEVNULL) as worker:
            try:
                wait_until(lambda: [one.state for one in job_store.workers()] == ["ready"], 30)
                with pytest.raises(subprocess.TimeoutExpired):
                    worker.wait(2)
                with capture_logs() as logs:
                    assert service.run_once() == 0
                assert {line["event"] for line in logs} == {"dispatch_postponed"}
                client.config_set("maxmemory", 0)
                wait_until(lambda: job_store.get(first.id).newest("checkpoint") is not None, 30)
                make_full(client)
                cancel(first.id, store=job_store, queue=service.queue)
                wait_until(lambda: job_store.get(first.id).status.is_final, 30)
                client.config_set("maxmemory", 0)
                assert service.run_once() == 1
                wait_until(lambda: job_store.get(second.id).newest("checkpoint") is not None, 30)
                make_full(client)
                worker.send_signal(signal.SIGTERM)
                assert worker.wait(30) == 0
            finally:
                worker.kill()
    ended, given_back = job_store.get(first.id), job_store.get(second.id)
    assert (ended.status, len(ended.attempts)) == (JobStatus.CANCELLED, 1)
    assert [attempt.reason for attempt in given_back.attempts] == [Reason.WORKER_DRAINED]


@pytest.mark.extra
def test_a_message_whose_work_horse_a_full_redis_ended_is_taken_again_at_once(
    job_store: PostgresJobStore, settings: WorkerSettings, own_valkey: Valkey
) -> None:
    """Seed 42039 of the campaign's outages: RQ's second try left it as started, for 70 s."""
    with connect_redis(own_valkey.url) as client:
        service = Service(job_store, client)
        service.submit()
        own = settings.model_copy(update={"redis_url": SecretStr(own_valkey.url)})
        worker = GaitwayWorker(own, "cpu", job_store)
        message, queue = worker.dequeue_job_and_maintain_ttl(1)
        worker.prepare_execution(message)
        assert service.run_once() == 0
        make_full(client)
        with pytest.raises(redis.exceptions.OutOfMemoryError):
            worker.handle_job_failure(message, queue)
        client.config_set("maxmemory", 0)
        worker.handle_job_failure(message, queue)
        assert service.run_once() == 1


def make_full(client: redis.Redis) -> None:
    client.config_set("maxmemory", 1)
    with pytest.raises(redis.exceptions.OutOfMemoryError):
        client.set("a", "b")
