"""The dispatches of attempts: a job that waits for a worker has one until RQ knows of it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import (
    ARRAY,
    Connection,
    Integer,
    Text,
    all_,
    and_,
    bindparam,
    delete,
    func,
    not_,
    or_,
    select,
    true,
)
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


def waiting(
    connection: Connection, room: Mapping[str, int], but_not: Collection[tuple[str, int]]
) -> Sequence[Dispatch]:
    """For each queue the oldest jobs that may begin, as many as it has room for, in the order of `room`.

    Its rows are found by the index `jobs_queued`: however many wait, only these are read.
    """
    wanted = func.unnest(bindparam("names", type_=ARRAY(Text)), bindparam("rooms", type_=ARRAY(Integer)))
    wanted = wanted.table_valued("name", "room", with_ordinality="place").render_derived("wanted")
    attempt, no = jobs.c.num_attempts + 1, bindparam("but_not", type_=ARRAY(Text))
    is_wanted = func.concat(jobs.c.id, " ", attempt) != all_(no)
    due = select(jobs.c.id, attempt.label("attempt")).where(jobs.c.status == "queued", _is_due(), is_wanted)
    of_queue = due.where(jobs.c.queue == wanted.c.name).order_by(jobs.c.queue, jobs.c.id).limit(wanted.c.room)
    found = of_queue.lateral("found")
    ordered = select(found).select_from(wanted.join(found, true())).order_by(wanted.c.place, found.c.id)
    without = due.where(jobs.c.queue.is_(None)).order_by(jobs.c.id).limit(max(room.values(), default=0))
    said = {
        "names": list(room),
        "rooms": list(room.values()),
        "but_not": [f"{job_id} {attempt}" for job_id, attempt in but_not],
    }
    rows = [*connection.execute(ordered, said), *connection.execute(without, said)]
    return [Dispatch("attempt", *row) for row in rows]


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
