"""Models, checkpoints of other jobs, and stored objects that jobs refer to."""

from collections.abc import Collection, Sequence

from sqlalchemy import Connection, select, union_all

from core.adapters.postgres.tables import UNFINISHED, artifacts, chunks, jobs


def users_of(connection: Connection, model_id: str) -> Sequence[str]:
    """The ids of unfinished jobs that name this model."""
    wanted = select(jobs.c.id).where(jobs.c.status.in_(UNFINISHED), jobs.c.model == model_id)
    return connection.execute(wanted.order_by(jobs.c.id)).scalars().all()


def borrowers_of(connection: Connection, job_id: str) -> Sequence[tuple[str, int | None]]:
    """The ids of unfinished jobs that need a checkpoint of this one, each with the step that it names."""
    wanted = select(jobs.c.id, jobs.c.source_step).where(
        jobs.c.status.in_(UNFINISHED), jobs.c.source == job_id
    )
    return [(row.id, row.source_step) for row in connection.execute(wanted.order_by(jobs.c.id))]


def objects_named(connection: Connection, job_ids: Collection[str]) -> Collection[str]:
    """The keys of these jobs' artifacts and chunks."""
    named = [select(table.c.key).where(table.c.job_id.in_(job_ids)) for table in (artifacts, chunks)]
    return set(connection.execute(union_all(*named)).scalars())
