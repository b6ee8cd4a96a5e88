"""A rehearsal: the database, the bucket, or both are restored to an older moment; `gaitway recover` looks."""

import secrets
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import psycopg
import pytest
import structlog
from typer.testing import CliRunner

from core.adapters.memory.queue import MemoryJobQueue
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.s3.objects import S3ObjectStore
from core.errors import JobNotFound
from core.jobs import feeds
from core.jobs.job import Job
from core.jobs.orphans import sweep
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.settings import WorkerSettings
from core.storage import keys
from core.user_models.record import ModelRecord
from gaitway.cli.main import app
from gaitway.service.embedded.postgres import binary
from gaitway.service.embedded.stack import lock_folder
from tests.conftest import Databases
from tests.contract.recording import LEASE, Database, watch
from tests.unit.jobs.playing import PlayedWorker

NOTHING_LEFT = "Nothing is left to do.\n"

Recover = Callable[..., tuple[int, str]]


@pytest.fixture
def recover(settings: WorkerSettings, monkeypatch: pytest.MonkeyPatch) -> Iterator[Recover]:
    """`gaitway recover` with these stores; its exit code, and what it printed."""
    for name in ("s3_endpoint", "s3_access_key", "s3_bucket", "s3_region"):
        monkeypatch.setenv(f"GAITWAY_{name.upper()}", getattr(settings, name))
    monkeypatch.setenv("GAITWAY_S3_SECRET_KEY", settings.s3_secret_key.get_secret_value())
    monkeypatch.setenv("GAITWAY_S3_SECURE", "false")
    monkeypatch.setenv("GAITWAY_REDIS_URL", settings.redis_url.get_secret_value())
    before = structlog.get_config()

    def call(database_url: str, *flags: str) -> tuple[int, str]:
        monkeypatch.setenv("GAITWAY_DATABASE_URL", database_url)
        result = CliRunner().invoke(app, ["recover", *flags])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result.exit_code, result.output

    yield call
    structlog.configure(**before)


@dataclass
class Backups:
    """Of the database and of the bucket, and what is restored from them."""

    databases: Databases
    url: str
    objects: S3ObjectStore
    folder: Path

    def save_database(self) -> None:
        dump = [binary("pg_dump"), "--format=custom", f"--file={self.folder / 'record.dump'}", self.url]
        subprocess.run(dump, check=True)

    def restored_database(self) -> str:
        """The address of a new database with the contents of the old one."""
        url = self.new_database()
        restore = [binary("pg_restore"), "--no-owner", "--exit-on-error", f"--dbname={url}"]
        subprocess.run([*restore, str(self.folder / "record.dump")], check=True)
        return url

    def new_database(self) -> str:
        """Without tables."""
        name = f"restored_{secrets.token_hex(6)}"
        self.databases.admin.execute(f"CREATE DATABASE {name}")
        return self.databases.server.admin_url.replace("/gaitway?", f"/{name}?")

    def save_bucket(self) -> None:
        self.saved = {info.key: self.objects.get(info.key) for info in self.objects.list("")}

    def restore_bucket(self) -> None:
        self.objects.delete_prefix("")
        for key, body in self.saved.items():
            self.objects.put(key, body)


@pytest.fixture
def backups(databases: Databases, database_url: str, object_store: S3ObjectStore, tmp_path: Path) -> Backups:
    return Backups(databases, database_url, object_store, tmp_path)


@pytest.fixture
def worker(job_store: PostgresJobStore, object_store: S3ObjectStore) -> PlayedWorker:
    return PlayedWorker(job_store, object_store)


@pytest.fixture
def opened() -> Iterator[Callable[[str], PostgresJobStore]]:
    """The record in another database."""
    stores: list[PostgresJobStore] = []

    def open_at(url: str) -> PostgresJobStore:
        stores.append(PostgresJobStore(connect_postgres(url)))
        return stores[-1]

    yield open_at
    for store in stores:
        store.close()


def compact(worker: PlayedWorker) -> None:
    """Move the feeds of all that has ended into chunks."""
    while feeds.compact(store=worker.store, objects=worker.objects):
        pass


def texts(job: Job, store: JobStore, objects: S3ObjectStore, channel: str = "logs") -> list[str]:
    found = feeds.read(job.id, channel, store=store, objects=objects)  # type: ignore[arg-type]
    return [entry.data["text"] for entry in found if "text" in entry.data]


def steps(job: Job) -> list[int | None]:
    return [artifact.step for artifact in job.artifacts if artifact.role == "checkpoint"]


def test_a_database_restored_to_an_older_moment_gets_back_what_the_bucket_knows(
    backups: Backups, worker: PlayedWorker, recover: Recover, opened: Callable[[str], PostgresJobStore]
) -> None:
    ended = worker.run(steps=2)
    compact(worker)
    claim = worker.begin(worker.submit())
    worker.checkpoint(claim, 1)
    queued = worker.submit()
    backups.save_database()
    # What happens from here on, the restored database does not know.
    worker.checkpoint(claim, 2)
    worker.say(claim, "logs", "the end is near")
    later_ended = worker.succeed(claim)
    later = worker.begin(queued)
    worker.checkpoint(later, 5)
    new = worker.begin(worker.submit(name="new"))
    worker.checkpoint(new, 3)
    worker.say(new, "logs", "hello", "world")
    new_ended = worker.succeed(new)
    half = worker.begin(worker.submit())
    worker.checkpoint(half, 7)
    never_begun = worker.submit()
    compact(worker)
    everything = [info.key for info in backups.objects.list("")]
    url = backups.restored_database()
    store = opened(url)

    code, said = recover(url)

    assert code == 1
    for job_id in (new_ended.id, half.job_id):
        assert f"Job {job_id}: not in the record." in said
    for job_id in (later_ended.id, queued.id):
        assert f"Job {job_id}: the record is older than its copy" in said
    assert ended.id not in said
    with pytest.raises(JobNotFound):
        store.get(new_ended.id)  # Nothing was changed.
    # Meanwhile nothing is lost to the reconciler, however old it is.
    for _ in sweep(store=store, objects=backups.objects, grace=timedelta(minutes=-1)):
        pass
    assert [info.key for info in backups.objects.list("")] == everything

    code, said = recover(url, "--adopt")

    assert (code, said.count(" Adopted.\n")) == (0, 4)
    assert recover(url) == (0, NOTHING_LEFT)
    assert recover(url, "--adopt", "--mark") == (0, NOTHING_LEFT)
    assert store.get(ended.id) == ended
    # What had ended is as it was, with its feeds.
    assert store.get(new_ended.id) == new_ended
    assert texts(new_ended, store, backups.objects) == ["hello", "world"]
    assert store.get(later_ended.id) == later_ended
    assert texts(later_ended, store, backups.objects) == ["the end is near"]
    # What had not ended waits for another attempt, which resumes from its newest checkpoint.
    for job_id, step in ((queued.id, 5), (half.job_id, 7)):
        job = store.get(job_id)
        assert (job.status, steps(job), job.next_attempt) == (JobStatus.QUEUED, [step], 2)
        assert job.attempts[0].reason == Reason.WORKER_LOST
    assert {dispatch.subject for dispatch in store.waiting()} == {queued.id, half.job_id}
    assert PlayedWorker(store, backups.objects).begin(job).number == 2
    # What no worker had begun was nowhere else.
    with pytest.raises(JobNotFound):
        store.get(never_begun.id)


def test_a_bucket_restored_to_an_older_moment_is_told_to_those_who_read(
    backups: Backups, worker: PlayedWorker, recover: Recover, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = worker.store
    ended = worker.run(steps=2)
    claim = worker.begin(worker.submit())
    worker.say(claim, "logs", *(f"line {number}" for number in range(1, 901)))
    worker.checkpoint(claim, 1)
    compact(worker)
    backups.save_bucket()
    worker.checkpoint(claim, 2, keep=1)  # The first one leaves the record.
    with monkeypatch.context() as patch:
        patch.setattr(feeds, "MAX_AGE", timedelta(0))  # Or it would take ten minutes.
        compact(worker)
    worker.say(claim, "logs", "line 901")
    new = worker.run(steps=1)
    compact(worker)
    backups.restore_bucket()

    code, said = recover(backups.url)

    assert code == 1
    new_name, lost_name, older_name = (f"checkpoint-{step:012d}.msgpack" for step in (1, 2, 1))
    num_events = store.marks([new.id])[new.id].num_events
    assert f"Job {new.id}: the bucket has lost {new_name}, events 1 to {num_events}." in said
    assert f"Job {claim.job_id}: the bucket has lost {lost_name}, events 1 to 2, logs 1 to 900." in said
    assert f"Job {claim.job_id}: an older copy of its record has {older_name}." in said
    assert ended.id not in said

    assert recover(backups.url, "--mark")[0] == 1  # The older checkpoint is left to adopt.
    assert recover(backups.url, "--adopt")[0] == 0
    assert recover(backups.url, "--adopt", "--mark") == (0, NOTHING_LEFT)

    assert store.get(ended.id) == ended
    assert steps(store.get(new.id)) == []
    assert f"removed from the record: {new_name}." in texts(new, store, backups.objects, "events")[-1]
    # The job goes on from what there is, under the same attempt.
    assert steps(store.get(claim.job_id)) == [1]
    worker.checkpoint(claim, 3)
    worker.say(claim, "logs", "line 902")
    lines = texts(store.get(claim.job_id), store, backups.objects)
    gap = "Entries 1 to 900 of this feed were lost from the object store."
    assert lines == [gap, "line 901", "line 902"]
    [first, *_] = feeds.read(claim.job_id, "logs", store=store, objects=backups.objects, after=500, limit=1)
    assert (first.id, first.kind) == ("900", "note")


def test_both_restored_to_one_moment_need_no_recovery(
    backups: Backups, worker: PlayedWorker, recover: Recover, opened: Callable[[str], PostgresJobStore]
) -> None:
    ended = worker.run()
    claim = worker.begin(worker.submit())
    worker.checkpoint(claim, 1)
    compact(worker)
    backups.save_bucket()
    backups.save_database()
    worker.checkpoint(claim, 2)
    worker.run()
    backups.restore_bucket()
    url = backups.restored_database()
    assert recover(url) == (0, NOTHING_LEFT)
    store = opened(url)
    assert store.get(ended.id) == ended
    # The worker of that time has gone; its lease has, too.
    reconciler = Reconciler(store, MemoryJobQueue(), LEASE)
    with psycopg.connect(url, autocommit=True) as connection:
        database = Database(connection)
        database.pass_time(timedelta(days=1))
        reconciler.look()  # The silence was too long to blame a worker for it.
        assert store.get(claim.job_id).token == claim.token
        watch(store, database)
        reconciler.look()
    job = store.get(claim.job_id)
    assert job.status == JobStatus.QUEUED
    assert steps(job) == [1]
    assert PlayedWorker(store, backups.objects).begin(job).number == 2


def test_a_database_that_is_lost_altogether_is_made_again_from_the_bucket(
    backups: Backups, worker: PlayedWorker, recover: Recover, opened: Callable[[str], PostgresJobStore]
) -> None:
    jobs = [worker.run(name=f"job {number}") for number in range(3)]
    model = ModelRecord(
        id=f"sha256:{1:064x}", status="ready", media_type="text/xml", size=1, created_at=worker.store.now()
    )
    worker.objects.put(keys.model_source(model.id), b"x", media_type=model.media_type)
    compact(worker)
    url = backups.new_database()
    code, said = recover(url)
    assert (code, "no tables yet" in said) == (1, True)
    assert recover(url, "--adopt")[0] == 0
    store = opened(url)
    assert [store.get(job.id) for job in jobs] == jobs
    found = store.find_model(model.id)
    assert (found.status, found.size, found.media_type) == ("validating", 1, "text/xml")
    assert ("model", model.id) in {(dispatch.task, dispatch.subject) for dispatch in store.waiting()}
    assert recover(url) == (0, NOTHING_LEFT)


def test_a_service_at_work_has_nothing_to_recover(
    backups: Backups, worker: PlayedWorker, recover: Recover
) -> None:
    worker.run()
    worker.submit()
    claim = worker.begin(worker.submit())
    worker.checkpoint(claim, 1)
    worker.upload(claim, "later", b"not published yet")
    assert recover(backups.url, "--adopt", "--mark") == (0, NOTHING_LEFT)


def test_the_embedded_servers_are_started_for_it(recover: Recover, tmp_path: Path) -> None:
    data = tmp_path / "data"
    assert recover("", "--data", str(data))[0] == 2  # No such folder, and none is made.
    assert not data.exists()
    (data / "postgres").mkdir(parents=True)
    with lock_folder(data):  # As by a service that runs there.
        code, said = recover("", "--data", str(data))
    assert (code, "already runs a service" in said) == (1, True)
    assert recover("", "--data", str(data), "--adopt") == (0, NOTHING_LEFT)
