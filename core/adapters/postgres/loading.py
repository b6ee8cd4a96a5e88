"""Jobs read from the database, with their attempts and artifacts; and how far they have come."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import structlog
from sqlalchemy import ARRAY, Connection, Text, any_, bindparam, case, func, literal, select

from core.adapters.postgres import rows
from core.adapters.postgres.tables import artifacts, attempts, jobs
from core.errors import JobNotFound, JobUnreadable
from core.jobs.job import Job, UnreadableJob
from core.jobs.store import Mark

log = structlog.get_logger()

# An array is one parameter: the statement is the same for any number of ids, and PostgreSQL has it prepared.
_IDS = bindparam("ids", type_=ARRAY(Text))
_ATTEMPTS_OF = select(attempts).where(attempts.c.job_id == any_(_IDS)).order_by(attempts.c.number)
_ARTIFACTS_OF = select(artifacts).where(artifacts.c.job_id == any_(_IDS)).order_by(artifacts.c.position)
_MARKS_OF = select(jobs.c.id, jobs.c.version, jobs.c.num_events, jobs.c.num_logs).where(
    jobs.c.id == any_(_IDS)
)


# In listings, whose readers look at the newest; a job itself has them all.
_MOST_LISTED = 10
_LONGEST_LISTED = 1000


def _brief_attempts() -> Any:
    from_last = func.row_number().over(partition_by=attempts.c.job_id, order_by=attempts.c.number.desc())
    shown = [column for column in attempts.c if column.name not in ("details", "message")]
    found = (
        select(
            *shown,
            literal("{}").label("details"),
            func.left(attempts.c.message, _LONGEST_LISTED).label("message"),
            from_last.label("place"),
        )
        .where(attempts.c.job_id == any_(_IDS))
        .subquery()
    )
    return select(found).where(found.c.place <= _MOST_LISTED).order_by(found.c.number)


def _brief_artifacts() -> Any:
    """The newest of each role; one without a step was made at the job's end."""
    from_last = func.row_number().over(
        partition_by=(artifacts.c.job_id, artifacts.c.role),
        order_by=(artifacts.c.step.desc().nulls_first(), artifacts.c.position.desc()),
    )
    shown = [column for column in artifacts.c if column.name != "metadata"]
    facts = case(
        (func.octet_length(artifacts.c.metadata) <= _LONGEST_LISTED, artifacts.c.metadata), else_="{}"
    )
    found = (
        select(*shown, facts.label("metadata"), from_last.label("place"))
        .where(artifacts.c.job_id == any_(_IDS))
        .subquery()
    )
    return select(found).where(found.c.place <= _MOST_LISTED).order_by(found.c.position)


_BRIEF_ATTEMPTS_OF, _BRIEF_ARTIFACTS_OF = _brief_attempts(), _brief_artifacts()


def find(connection: Connection, job_id: str) -> Job | UnreadableJob:
    """Raises JobNotFound."""
    row = connection.execute(select(jobs).where(jobs.c.id == job_id)).first()
    if row is None:
        raise JobNotFound(job_id[:64])
    return of_rows(connection, [row])[0]


def of_rows(
    connection: Connection, found: Sequence[Any], *, brief: bool = False
) -> list[Job | UnreadableJob]:
    """The jobs of these rows, with at most two queries for all of them together.

    brief: with their newest attempts and files alone, and without what these say at length about themselves.
    """
    if not found:
        return []
    ids = {"ids": [row.id for row in found]}
    tries: dict[str, list[Any]] = defaultdict(list)
    files: dict[str, list[Any]] = defaultdict(list)
    if any(row.num_attempts for row in found):
        for row in connection.execute(_BRIEF_ATTEMPTS_OF if brief else _ATTEMPTS_OF, ids):
            tries[row.job_id].append(row)
    for row in connection.execute(_BRIEF_ARTIFACTS_OF if brief else _ARTIFACTS_OF, ids):
        files[row.job_id].append(row)
    return [rows.read_job(row, tries[row.id], files[row.id]) for row in found]


def readable(job: Job | UnreadableJob) -> Job:
    """Raises JobUnreadable."""
    if isinstance(job, UnreadableJob):
        raise JobUnreadable(job.id, job.problem)
    return job


def without_unreadable(found: Iterable[Job | UnreadableJob]) -> list[Job]:
    for job in found:
        if isinstance(job, UnreadableJob):
            log.warning("job_unreadable", job_id=job.id, problem=job.problem)
    return [job for job in found if isinstance(job, Job)]


def marks(connection: Connection, job_ids: Collection[str]) -> Mapping[str, Mark]:
    found = connection.execute(_MARKS_OF, {"ids": list(job_ids)})
    return {row.id: Mark(row.version, row.num_events, row.num_logs) for row in found}
