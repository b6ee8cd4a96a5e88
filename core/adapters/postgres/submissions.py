"""Submissions: new jobs, and the idempotency keys they came with.

A new job's row, dispatch and key are one statement, which is its own transaction and is built once: BEGIN,
COMMIT and building it again would take most of a submission's time.
"""

import hashlib
from datetime import timedelta
from functools import cache
from typing import Any

from sqlalchemy import Boolean, Connection, bindparam, delete, exists, literal, select
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import rows, saving
from core.adapters.postgres.tables import NOW, dispatches, idempotency_keys, jobs
from core.errors import IdempotencyKeyReused
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import Idempotency

REMEMBERED = timedelta(hours=24)


def add(connection: Connection, job: Job, idempotency: Idempotency | None = None) -> bool:
    """Add the job with its attempts and artifacts; False if its key is remembered, and nothing was added.

    Raises IntegrityError if the id exists.
    """
    is_new = _add_row(connection, job, idempotency)
    if is_new:
        saving.write_attempts(connection, job.id, job.attempts)
        if job.artifacts:
            saving.write_artifacts(connection, job)
    return is_new


def _add_row(connection: Connection, job: Job, idempotency: Idempotency | None) -> bool:
    """The second of two submissions with one key waits until the first is committed or rolled back."""
    row = rows.new_job_values(job)
    values = {**row, "attempt": job.next_attempt, "is_queued": job.status == JobStatus.QUEUED}
    if idempotency is not None:
        values |= {"key_hash": hashed(idempotency.key), "fingerprint": idempotency.fingerprint}
    statement = _statement(tuple(row), has_key=idempotency is not None)
    return connection.execute(statement, values).first() is not None


@cache
def _statement(names: tuple[str, ...], *, has_key: bool) -> Any:
    columns = [jobs.c[name] for name in names]
    new = select(*(bindparam(column.name, type_=column.type) for column in columns))
    if has_key:
        new = new.where(exists(select(_new_key().c.job_id)))
    job = insert(jobs).from_select(columns, new).returning(jobs.c.id).cte("job")
    attempt = bindparam("attempt", type_=dispatches.c.attempt.type)
    waits = select(literal("attempt"), job.c.id, attempt, NOW).where(bindparam("is_queued", type_=Boolean))
    dispatch = insert(dispatches).from_select(list(dispatches.c), waits).on_conflict_do_nothing()
    return select(job.c.id).add_cte(dispatch.cte("dispatch"))


def _new_key() -> Any:
    said: dict[str, Any] = {
        "fingerprint": bindparam("fingerprint"),
        "job_id": bindparam("id"),
        "forgotten_at": NOW + REMEMBERED,
    }
    return (
        insert(idempotency_keys)
        .values(key_hash=bindparam("key_hash"), **said)
        .on_conflict_do_update(
            index_elements=["key_hash"], set_=said, where=idempotency_keys.c.forgotten_at <= NOW
        )
        .returning(idempotency_keys.c.job_id)
        .cte("key")
    )


def remembered(connection: Connection, idempotency: Idempotency) -> str | None:
    """The id of the job that was submitted with this key. Raises IdempotencyKeyReused."""
    row = connection.execute(
        select(idempotency_keys).where(
            idempotency_keys.c.key_hash == hashed(idempotency.key),
            idempotency_keys.c.forgotten_at > NOW,
        )
    ).first()
    if row is None:
        return None
    if row.fingerprint != idempotency.fingerprint:
        raise IdempotencyKeyReused(idempotency.key)
    return row.job_id


def forget_old_keys(connection: Connection) -> None:
    connection.execute(delete(idempotency_keys).where(idempotency_keys.c.forgotten_at <= NOW))


def hashed(key: str) -> str:
    return hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()
