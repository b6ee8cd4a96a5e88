"""What a worker on another machine may do in PostgreSQL: run jobs, and see no accounts."""

import secrets
from datetime import timedelta

import psycopg
import pytest

from core.accounts.store import Actor
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.adapters.postgres.tables import metadata
from core.adapters.postgres.worker_role import RIGHTS, prepare_worker_role
from core.errors import Misconfigured
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.contract.recording import LEASE, NOW, artifact, line, model, queued_job
from tests.in_memory import MemoryObjectStore


@pytest.fixture
def worker_url(database_url: str) -> str:
    """The address of a role that there is not yet; roles are the server's, databases the test's."""
    user = f"worker_{secrets.token_hex(4)}"
    return f"postgresql://{user}:word@{database_url.rpartition('@')[2]}"


@pytest.fixture
def as_worker(database_url: str, worker_url: str) -> PostgresJobStore:
    prepare_worker_role(connect_postgres(database_url, pool_size=0), worker_url)
    return PostgresJobStore(connect_postgres(worker_url, pool_size=0))


def test_a_worker_runs_a_job_from_its_claim_to_its_end(
    job_store: PostgresJobStore, as_worker: PostgresJobStore
) -> None:
    job = job_store.add(queued_job())
    as_worker.ping()
    info = WorkerInfo(name="w", host="h", pid=1, device="cpu", started_at=NOW, seen_at=NOW)
    as_worker.announce(info, timedelta(minutes=1))
    claim = claim_attempt(
        job.id, 1, "w", store=as_worker, objects=MemoryObjectStore(), lease=LEASE, secret=new_secret()
    )
    assert claim is not None
    claim.start(device="cpu", engine="native", details={})
    as_worker.renew(job.id, claim.token, LEASE)
    as_worker.record(job.id, claim.token, "logs", [line("hello")], write_id="w")
    claim.publish((artifact("1.ckpt"),), keep_checkpoints=5)
    claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "It came to its end.")
    assert job_store.get(job.id).status == JobStatus.SUCCEEDED
    job_store.models.add(record := model(status="validating"))
    as_worker.models.settle(record.model_copy(update={"status": "refused", "message": "no"}))
    as_worker.withdraw("w")


def test_it_sees_neither_users_nor_tokens_nor_the_audit_log(
    as_worker: PostgresJobStore, worker_url: str
) -> None:
    with psycopg.connect(worker_url, autocommit=True) as connection:
        for table in {table.name for table in metadata.sorted_tables} - RIGHTS.keys():
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                connection.execute(f"SELECT * FROM {table}".encode())  # noqa: S608
        for statement in (b"DELETE FROM jobs", b"INSERT INTO jobs (id) VALUES ('x')", b"DROP TABLE jobs"):
            with pytest.raises(psycopg.errors.InsufficientPrivilege):
                connection.execute(statement)
        with pytest.raises(psycopg.errors.InsufficientPrivilege):
            connection.execute(b"CREATE TABLE mine (id integer)")


def test_a_second_start_changes_nothing_and_takes_back_what_was_given_by_hand(
    database_url: str, worker_url: str, as_worker: PostgresJobStore, job_store: PostgresJobStore
) -> None:
    user = worker_url.partition("//")[2].partition(":")[0]
    with psycopg.connect(database_url, autocommit=True) as connection:
        connection.execute(f"GRANT SELECT ON tokens TO {user}".encode())
    prepare_worker_role(connect_postgres(database_url, pool_size=0), worker_url)
    with psycopg.connect(worker_url) as connection, pytest.raises(psycopg.errors.InsufficientPrivilege):
        connection.execute(b"SELECT * FROM tokens")
    job_store.add_project("p", Actor())
    as_worker.ping()


@pytest.mark.parametrize(
    "rights", ["SUPERUSER", "CREATEROLE", "IN ROLE pg_read_all_data", "NOINHERIT IN ROLE {own}"]
)
def test_a_user_with_rights_of_its_own_is_no_workers(
    database_url: str, worker_url: str, job_store: PostgresJobStore, rights: str
) -> None:
    user = worker_url.partition("//")[2].partition(":")[0]
    with psycopg.connect(database_url, autocommit=True) as connection:
        rights = rights.format(own=connection.info.user)
        connection.execute(f"CREATE ROLE {user} LOGIN PASSWORD 'word' {rights}".encode())
    with pytest.raises(Misconfigured, match="rights of its own"):
        prepare_worker_role(connect_postgres(database_url, pool_size=0), worker_url)


def test_the_services_own_user_is_no_workers(database_url: str) -> None:
    engine = connect_postgres(database_url, pool_size=0)
    for url in (database_url, "postgresql://worker@h/d", "postgresql://h/d"):
        with pytest.raises(Misconfigured, match="a user of its own, and a password"):
            prepare_worker_role(engine, url)
