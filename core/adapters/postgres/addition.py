"""A new job, its dispatch, and the key it came with: one statement, which is its own transaction.

It is built once. Most of a submission's time would go into BEGIN, COMMIT and building it anew.
"""

import hashlib
from datetime import timedelta
from functools import cache
from typing import Any

from sqlalchemy import Boolean, Connection, bindparam, exists, literal, select
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import rows
from core.adapters.postgres.tables import NOW, dispatches, idempotency_keys, jobs
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import Idempotency

REMEMBERED = timedelta(hours=24)


def add(connection: Connection, job: Job, idempotency: Idempotency | None) -> bool:
    """Whether the job was added: its key is not remembered. Raises IntegrityError for an id that is there.

    Of two submissions with one key, the second waits until the first is committed or rolled back.
    """
    row = rows.new_job_values(job)
    values = {**row, "attempt": job.next_attempt, "is_queued": job.status == JobStatus.QUEUED}
    if idempotency is not None:
        values |= {"key_hash": hashed(idempotency.key), "fingerprint": idempotency.fingerprint}
    statement = _statement(tuple(row), has_key=idempotency is not None)
    return connection.execute(statement, values).first() is not None


def hashed(key: str) -> str:
    """What is stored of an idempotency key."""
    return hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()


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
