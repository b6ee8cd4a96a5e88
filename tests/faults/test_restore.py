"""`gaitway check` compares the record with the bucket; the restore of docs/operations.md is rehearsed."""

import os
import re
import secrets
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path

import psycopg
import pytest
import structlog
from typer.testing import CliRunner

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.postgres.worker_role import prepare_worker_role
from core.adapters.s3.objects import S3ObjectStore
from core.adapters.wiring import job_store as job_store_of
from core.adapters.wiring import object_store as object_store_of
from core.errors import ModelNotFound
from core.jobs import feeds
from core.jobs.job import Job
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.settings import StoreSettings, WorkerSettings
from core.storage import keys
from core.storage.objects import ObjectStore
from core.user_models.record import ModelRecord
from gaitway.cli.main import app
from gaitway.service.embedded.postgres import binary
from gaitway.service.embedded.servers import EmbeddedServers
from gaitway.service.embedded.stack import lock_folder
from tests.conftest import Databases
from tests.contract.recording import LEASE, Database, watch
from tests.feeds import read_feed
from tests.in_memory import MemoryJobQueue
from tests.unit.jobs.playing import PlayedWorker

NOBODYS = "019aa3c2f0b1-0000000000"
GUIDE = Path(__file__).parents[2] / "docs" / "operations.md"

Check = Callable[..., tuple[int, str]]


@pytest.fixture
def check(settings: WorkerSettings, monkeypatch: pytest.MonkeyPatch) -> Iterator[Check]:
    """`gaitway check` with these stores; its exit code, and what it printed."""
    for name in ("s3_endpoint", "s3_access_key", "s3_bucket", "s3_region"):
        monkeypatch.setenv(f"GAITWAY_{name.upper()}", getattr(settings, name))
    monkeypatch.setenv("GAITWAY_S3_SECRET_KEY", settings.s3_secret_key.get_secret_value())
    monkeypatch.setenv("GAITWAY_S3_SECURE", "false")
    monkeypatch.setenv("GAITWAY_REDIS_URL", settings.redis_url.get_secret_value())
    before = structlog.get_config()

    def call(database_url: str, *flags: str) -> tuple[int, str]:
        monkeypatch.setenv("GAITWAY_DATABASE_URL", database_url)
        result = CliRunner().invoke(app, ["check", *flags])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result.exit_code, result.output

    yield call
    structlog.configure(**before)


@pytest.fixture
def worker(job_store: PostgresJobStore, object_store: S3ObjectStore) -> PlayedWorker:
    return PlayedWorker(job_store, object_store)


def compact(worker: PlayedWorker) -> None:
    """Move the feeds of all that has ended, or is due, into chunks."""
    while feeds.compact(store=worker.store, objects=worker.objects):
        pass


def texts(job_id: str, store: JobStore, objects: ObjectStore, channel: str = "logs") -> list[str]:
    found = read_feed(job_id, channel, store=store, objects=objects)  # type: ignore[arg-type]
    return [entry.data["text"] for entry in found if "text" in entry.data]


def steps(job: Job) -> list[int | None]:
    return [artifact.step for artifact in job.artifacts if artifact.role == "checkpoint"]


def model(number: int, store: JobStore) -> ModelRecord:
    return ModelRecord(
        id=f"sha256:{number:064x}", status="ready", media_type="text/xml", size=1, created_at=store.now()
    )


def test_what_the_bucket_lacks_is_listed_by_job_and_marked(
    database_url: str, worker: PlayedWorker, check: Check, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, objects = worker.store, worker.objects
    whole = worker.run(steps=2)
    claim = worker.begin(worker.submit())
    worker.say(claim, "logs", *(f"line {number}" for number in range(1, 901)))
    kept, lost = worker.checkpoint(claim, 1), worker.checkpoint(claim, 2)
    monkeypatch.setattr(feeds, "MAX_AGE", timedelta(0))  # Or it would take ten minutes.
    compact(worker)
    worker.say(claim, "logs", "line 901")
    empty = worker.run(steps=1)
    store.models.add(model(1, store))
    [part] = [chunk.key for chunk in store.chunks([claim.job_id])[claim.job_id] if chunk.channel == "logs"]
    objects.delete([lost.key, part])
    objects.delete_prefix(keys.job(empty.id))

    code, said = check(database_url)

    assert code == 1
    assert said.splitlines() == [
        f"{claim.job_id}: the bucket lacks {lost.key}, {part}.",
        f"{empty.id}: the bucket lacks {empty.artifacts[0].key}.",
        f"{model(1, store).id}: the bucket lacks {keys.model_source(model(1, store).id)}.",
    ]
    assert steps(store.get(claim.job_id)) == [1, 2]  # Nothing was changed.

    assert check(database_url, "--mark") == (0, said)
    assert check(database_url) == (0, "")

    assert store.get(whole.id) == whole
    assert steps(store.get(empty.id)) == []
    note = f"Lost from the object store, and removed from the record: {empty.artifacts[0].name}."
    assert texts(empty.id, store, objects, "events")[-1] == note
    with pytest.raises(ModelNotFound):
        store.models.find(model(1, store).id)
    # The job that runs goes on from what there is, under the same attempt.
    assert store.get(claim.job_id).artifacts == (kept,)
    worker.checkpoint(claim, 3)
    worker.say(claim, "logs", "line 902")
    gap = "Entries 1 to 900 of this feed were lost from the object store."
    assert texts(claim.job_id, store, objects) == [gap, "line 901", "line 902"]
    [first, *_] = read_feed(claim.job_id, "logs", store=store, objects=objects, after=500, limit=1)
    assert (first.id, first.kind) == ("900", "note")


def test_what_no_record_names_is_listed_and_stays(
    database_url: str, worker: PlayedWorker, check: Check
) -> None:
    claim = worker.begin(worker.submit())
    worker.checkpoint(claim, 1)
    worker.store.models.add(model(1, worker.store))
    worker.objects.put(keys.model_source(model(1, worker.store).id), b"x")
    ended = worker.run()
    compact(worker)
    assert check(database_url, "--mark") == (0, "")
    coming = worker.upload(claim, "coming", b"not published yet")
    forgotten = keys.artifact(NOBODYS, 1, "0" * 64, "video.mp4")
    worker.objects.put(forgotten, b"x")
    source = keys.model_source(model(2, worker.store).id)
    worker.objects.put(source, b"x")
    before = [info.key for info in worker.objects.list("")]

    assert check(database_url, "--mark") == (
        0,
        f"{NOBODYS}: no record names {forgotten}.\n"
        f"{claim.job_id}: no record names {coming.key}.\n"
        f"{model(2, worker.store).id}: no record names {source}.\n",
    )

    assert [info.key for info in worker.objects.list("")] == before
    assert worker.store.get(ended.id) == ended


def test_what_a_deletion_left_is_no_difference(database_url: str, worker: PlayedWorker, check: Check) -> None:
    job = worker.run()
    worker.store.delete(job.id, job.version)  # The reconciler removes its objects.
    assert check(database_url) == (0, "")


def test_a_database_and_a_bucket_that_was_saved_after_it_need_no_repair(
    databases: Databases, database_url: str, worker: PlayedWorker, check: Check, tmp_path: Path
) -> None:
    ended = worker.run()
    claim = worker.begin(worker.submit())
    worker.checkpoint(claim, 1)
    compact(worker)
    role = f"worker_{secrets.token_hex(6)}"
    engine = connect_postgres(database_url)
    prepare_worker_role(engine, f"postgresql://{role}:word@db/gaitway")
    engine.dispose()
    dump = tmp_path / "record.dump"
    subprocess.run([binary("pg_dump"), "-Fc", f"--file={dump}", database_url], check=True)
    with psycopg.connect(database_url, autocommit=True) as connection:  # Another server has no such user.
        connection.execute(f"DROP OWNED BY {role}")
        connection.execute(f"DROP ROLE {role}")
    worker.checkpoint(claim, 2)
    later = worker.run()
    compact(worker)
    saved = {info.key: worker.objects.get(info.key) for info in worker.objects.list("")}
    worker.checkpoint(claim, 3, keep=1)
    worker.run()

    worker.objects.delete_prefix("")
    for key, body in saved.items():
        worker.objects.put(key, body)
    name = f"restored_{secrets.token_hex(6)}"
    databases.admin.execute(f"CREATE DATABASE {name}")
    url = databases.server.admin_url.replace("/gaitway?", f"/{name}?")
    options = ["--clean", "--if-exists", "--no-owner", "--no-privileges"]
    assert " ".join(options) in GUIDE.read_text()
    restoring = [*options, "--exit-on-error", f"--dbname={url}", str(dump)]
    subprocess.run([binary("pg_restore"), *restoring], check=True)

    code, said = check(url)
    assert code == 0
    assert {line.partition(": no record names ")[0] for line in said.splitlines()} == {claim.job_id, later.id}
    store = PostgresJobStore(connect_postgres(url))
    assert store.get(ended.id) == ended
    # The worker of that time has gone; its lease has, too.
    reconciler = Reconciler(store, MemoryJobQueue(), LEASE)
    with psycopg.connect(url, autocommit=True) as connection:
        database = Database(connection)
        database.pass_time(timedelta(days=1))
        reconciler.run_once()  # The silence was too long to blame a worker for it.
        assert store.get(claim.job_id).token == claim.token
        watch(store, database)
        reconciler.run_once()
    job = store.get(claim.job_id)
    assert (job.status, steps(job)) == (JobStatus.QUEUED, [1])
    assert PlayedWorker(store, worker.objects).begin(job).number == 2
    store.close()


def commands_with(text: str) -> str:
    """The shell commands of the guide's block in which this text stands."""
    [block] = [
        block for block in re.findall(r"```sh\n(.*?)```", GUIDE.read_text(), re.DOTALL) if text in block
    ]
    return block


@pytest.mark.extra
def test_the_restore_of_a_data_folder_as_it_is_documented(tmp_path: Path) -> None:
    def type_in(commands: str) -> str:
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environ = {**os.environ, "PATH": path}
        return subprocess.check_output(["sh", "-euc", commands], cwd=tmp_path, env=environ, text=True)

    def service(servers: EmbeddedServers) -> PlayedWorker:
        found = servers.environment().items()
        stores = StoreSettings.model_validate({name[8:].lower(): value for name, value in found})
        return PlayedWorker(job_store_of(stores, pool_size=0), object_store_of(stores))

    data = tmp_path / "gaitway-data"
    with EmbeddedServers(data) as servers:
        schema.upgrade(connect_postgres(servers.postgres.url, pool_size=0))
        before = service(servers).run(steps=2)
    type_in(commands_with("-cf gaitway-backup.tar"))
    with EmbeddedServers(data) as servers:
        after = service(servers)
        lost = after.run()
        after.objects.delete_prefix(keys.job(before.id))

    assert type_in(commands_with("gaitway check --data")) == ""

    with EmbeddedServers(data) as servers:
        found = service(servers)
        assert [job.id for job in found.store.jobs_of([before.id, lost.id]).values()] == [before.id]
        assert found.store.get(before.id) == before
        for artifact in before.artifacts:
            assert len(found.objects.get(artifact.key)) == artifact.size


def test_a_folder_that_is_none_or_in_use_is_refused(check: Check, tmp_path: Path) -> None:
    data = tmp_path / "data"
    assert check("", "--data", str(data))[0] == 2  # No such folder, and none is made.
    assert not data.exists()
    (data / "postgres").mkdir(parents=True)
    with lock_folder(data):  # As by a service that runs there.
        code, said = check("", "--data", str(data))
    assert (code, "already runs a service" in said) == (1, True)
