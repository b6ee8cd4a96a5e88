"""The dispatches of attempts: a job that waits for a worker has one until RQ knows of it."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import Connection, and_, bindparam, delete, not_, or_, select
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres.tables import NOW, dispatches, jobs
from core.jobs.attempts import PAUSES
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch

# Built once: it is a part of every submission.
_REMOVE = delete(dispatches).where(
    dispatches.c.task == bindparam("task"),
    dispatches.c.subject == bindparam("subject"),
    dispatches.c.attempt == bindparam("attempt"),
)


def waiting(connection: Connection) -> Sequence[Dispatch]:
    """The next attempt of every queued job that may begin."""
    queued = select(jobs.c.id, jobs.c.num_attempts + 1).where(jobs.c.status == "queued", _is_due())
    return [Dispatch("attempt", *row) for row in connection.execute(queued.order_by(jobs.c.id))]


def undispatched(connection: Connection) -> Sequence[Dispatch]:
    """Dispatches of jobs and models that may begin, oldest first."""
    of_jobs = dispatches.outerjoin(jobs, dispatches.c.subject.collate("C") == jobs.c.id)
    wanted = select(dispatches).select_from(of_jobs).where(_is_due())
    wanted = wanted.order_by(dispatches.c.created_at).limit(1000)
    return [Dispatch(row.task, row.subject, row.attempt) for row in connection.execute(wanted)]


def remove(connection: Connection, done: Sequence[Dispatch]) -> None:
    connection.execute(_REMOVE, [asdict(dispatch) for dispatch in done])


def update(connection: Connection, job: Job) -> None:
    """Add a dispatch for a job that waits for a worker; remove it for any other."""
    if job.status == JobStatus.QUEUED:
        connection.execute(
            insert(dispatches)
            .values(task="attempt", subject=job.id, attempt=job.next_attempt, created_at=NOW)
            .on_conflict_do_nothing()
        )
    else:
        forget(connection, job.id)


def forget(connection: Connection, job_id: str) -> None:
    connection.execute(
        delete(dispatches).where(dispatches.c.task == "attempt", dispatches.c.subject == job_id)
    )


def _is_due() -> Any:
    """Whether a job may be tried now.

    A `not_before` further ahead than the longest pause was set before the clock was set back; it is ignored.
    """
    not_yet = and_(jobs.c.not_before > NOW, jobs.c.not_before <= NOW + max(PAUSES))
    return or_(jobs.c.not_before.is_(None), not_(not_yet))
