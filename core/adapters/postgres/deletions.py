"""Jobs that are deleted, whose objects may still be there: a job leaves the record before its objects go."""

from collections.abc import Sequence
from datetime import timedelta

from sqlalchemy import Connection, delete, insert, select

from core.adapters.postgres import references, saving
from core.adapters.postgres.tables import NOW, deletions, jobs
from core.errors import JobInUse, JobNotFound


def begin(connection: Connection, job_id: str, version: int) -> None:
    """Remove the job from the record. Raises StaleJob, JobNotFound, JobInUse."""
    # With `hold_source`: whoever comes second waits here, and then sees what the first one did.
    connection.execute(select(jobs.c.id).where(jobs.c.id == job_id).with_for_update())
    if borrowers := [borrower for borrower, _ in references.borrowers_of(connection, job_id)]:
        raise JobInUse(job_id, borrowers)
    saving.remove(connection, job_id, version)
    connection.execute(insert(deletions).values(job_id=job_id, begun_at=NOW))


def hold_source(connection: Connection, job_id: str) -> None:
    """Let nobody delete this job before the transaction ends. Raises JobNotFound."""
    row = select(jobs.c.id).where(jobs.c.id == job_id).with_for_update(key_share=True, read=True)
    if connection.execute(row).first() is None:
        raise JobNotFound(job_id)


def begun(connection: Connection, before: timedelta) -> Sequence[str]:
    """Those that began at least so long ago."""
    old = select(deletions.c.job_id).where(deletions.c.begun_at <= NOW - before)
    return connection.execute(old.order_by(deletions.c.job_id)).scalars().all()


def ended(connection: Connection, job_id: str) -> None:
    connection.execute(delete(deletions).where(deletions.c.job_id == job_id))
