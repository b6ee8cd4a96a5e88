"""The next version of a job, written if the stored version is the one before."""

from collections.abc import Sequence
from datetime import timedelta
from typing import Any, NoReturn

from sqlalchemy import Connection, case, delete, exists, select, update
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import dispatch, feeds, rows
from core.adapters.postgres.tables import NOW, artifacts, attempts, jobs
from core.errors import JobNotFound, StaleJob
from core.jobs.entries import status_entry
from core.jobs.job import Attempt, Job
from core.jobs.status import JobStatus

# Rows of one call, which has two seconds: an import of 5,000 files was refused as an outage.
_AT_ONCE = 500


def save(connection: Connection, job: Job, *conditions: Any, lease: timedelta | None = None) -> None:
    """Write the job, its attempts and artifacts, the event and the dispatch of a change of status.

    Raises StaleJob, JobNotFound.
    """
    before = replace(connection, job, job.version - 1, *conditions, lease=lease)
    # A step changes the last attempt, or the one before it.
    write_attempts(connection, job.id, job.attempts[-2:])
    if job.artifacts or before.has_artifacts:
        write_artifacts(connection, job)
    if before.status != job.status:
        feeds.append(connection, job.id, "events", [status_entry(job)])
    if JobStatus.QUEUED in (before.status, job.status):
        dispatch.update(connection, job)


def replace(
    connection: Connection, job: Job, version: int, *conditions: Any, lease: timedelta | None = None
) -> Any:
    """Replace this version in the job's own row; returns the `status` from before, and `has_artifacts`.

    Raises StaleJob, JobNotFound.
    """
    values = rows.job_values(job)
    # A lease belongs to the present attempt; a change of hands ends the one before.
    same_holder = jobs.c.token == job.token
    kept = case((same_holder, jobs.c.lease_until), else_=None) if job.token else None
    values["lease_until"] = NOW + rows.interval(lease) if lease is not None and job.token else kept
    before = select(jobs.c.status).where(jobs.c.id == job.id).scalar_subquery()
    has_artifacts = exists().where(artifacts.c.job_id == job.id)
    changed = connection.execute(
        update(jobs)
        .where(jobs.c.id == job.id, jobs.c.version == version, *conditions)
        .values(values)
        .returning(before.label("status"), has_artifacts.label("has_artifacts"))
    ).first()
    if changed is None:
        _refuse(connection, job.id)
    return changed


def remove(connection: Connection, job_id: str, version: int) -> None:
    """Raises StaleJob, JobNotFound."""
    found = connection.execute(
        delete(jobs).where(jobs.c.id == job_id, jobs.c.version == version).returning(jobs.c.id)
    )
    if found.first() is None:
        _refuse(connection, job_id)
    dispatch.forget(connection, job_id)


def write_attempts(connection: Connection, job_id: str, changed: Sequence[Attempt]) -> None:
    if not changed:
        return
    statement = insert(attempts)
    changes = {
        column.name: statement.excluded[column.name] for column in attempts.c if not column.primary_key
    }
    connection.execute(
        statement.on_conflict_do_update(index_elements=["job_id", "number"], set_=changes),
        [rows.attempt_values(job_id, attempt) for attempt in changed],
    )


def write_artifacts(connection: Connection, job: Job) -> None:
    stored = connection.execute(
        select(artifacts.c.name, artifacts.c.position, artifacts.c.key).where(artifacts.c.job_id == job.id)
    ).all()
    have = {row.name: row for row in stored}
    if gone := have.keys() - {artifact.name for artifact in job.artifacts}:
        connection.execute(delete(artifacts).where(artifacts.c.job_id == job.id, artifacts.c.name.in_(gone)))
    top = max((row.position for row in stored), default=0)
    new: list[rows.Values] = []
    for artifact in job.artifacts:
        known = have.get(artifact.name)
        if known is None:
            top += 1
        if known is None or known.key != artifact.key:
            new.append(rows.artifact_values(job.id, top if known is None else known.position, artifact))
    if new:
        statement = insert(artifacts)
        changes = {name: statement.excluded[name] for name in new[0] if name not in ("job_id", "name")}
        write = statement.on_conflict_do_update(index_elements=["job_id", "name"], set_=changes)
        for at in range(0, len(new), _AT_ONCE):
            connection.execute(write, new[at : at + _AT_ONCE])


def _refuse(connection: Connection, job_id: str) -> NoReturn:
    if connection.execute(select(jobs.c.id).where(jobs.c.id == job_id)).first() is None:
        raise JobNotFound(job_id[:64])
    raise StaleJob(job_id)
