"""Copies of jobs in the object store: the jobs that need a copy, and jobs restored from one."""

from collections.abc import Sequence

from sqlalchemy import Connection, select, update
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import dispatch, feeds, loading, rows, saving
from core.adapters.postgres.tables import jobs
from core.jobs.entries import status_entry
from core.jobs.job import Job, UnreadableJob, utc_now
from core.jobs.store import Chunk, Entry


def uncopied(connection: Connection, limit: int) -> Sequence[Job | UnreadableJob]:
    """Jobs that have begun, and whose copy is of another version; oldest first."""
    wanted = select(jobs).where(jobs.c.copied_version != jobs.c.version, jobs.c.num_attempts > 0)
    return loading.of_rows(connection, connection.execute(wanted.order_by(jobs.c.id).limit(limit)).all())


def copied(connection: Connection, job_id: str, version: int) -> bool:
    """Record that the copy is of this version; whether the job is still there."""
    marked = update(jobs).where(jobs.c.id == job_id).values(copied_version=version).returning(jobs.c.id)
    return connection.execute(marked).first() is not None


def restore(
    connection: Connection, job: Job, replaces: int | None, note: str, chunks: Sequence[Chunk]
) -> None:
    """Write a job from its copy, with its chunks and a note in its events.

    replaces: the stored version; None if there is none. Raises StaleJob, JobNotFound, IntegrityError.
    """
    said = [Entry(kind="note", time=utc_now(), data={"text": note})]
    if replaces is None:
        connection.execute(insert(jobs).values(rows.new_job_values(job)))
    elif saving.replace(connection, job, replaces).status != job.status:
        said.append(status_entry(job))
    saving.write_attempts(connection, job.id, job.attempts)
    saving.write_artifacts(connection, job)
    feeds.adopt(connection, job.id, chunks)
    feeds.append(connection, job.id, "events", said, job.progress)
    dispatch.update(connection, job)
