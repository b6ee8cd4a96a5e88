"""Which jobs wait for a worker, and which attempt holds one: dispatches and leases.

A job that waits has a dispatch until RQ knows of it. Leases are by the database's clock.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import timedelta
from typing import Any

import structlog
from sqlalchemy import (
    ARRAY,
    Connection,
    Integer,
    Text,
    all_,
    and_,
    bindparam,
    case,
    delete,
    func,
    literal,
    not_,
    or_,
    select,
    text,
    true,
    union_all,
    update,
)
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import uploads
from core.adapters.postgres.engine import Session
from core.adapters.postgres.rows import HELD, age_s, interval, jobs_of_rows
from core.adapters.postgres.tables import NOW, UNFINISHED, attempts, dispatches, jobs, pulse
from core.errors import LeaseLost
from core.jobs.attempts import PAUSES
from core.jobs.job import Job, UnreadableJob
from core.jobs.queue import MODELS, MOST_WAITING, SEVERAL_HOSTS, all_queues
from core.jobs.slots import QueueCount
from core.jobs.status import JobStatus
from core.jobs.store import Dispatch, Renewal

log = structlog.get_logger()

# Built once: it is a part of every submission.
_REMOVE = delete(dispatches).where(
    dispatches.c.task == bindparam("task"),
    dispatches.c.subject == bindparam("subject"),
    dispatches.c.attempt == bindparam("attempt"),
)
_FORGET = delete(dispatches).where(
    dispatches.c.task == "attempt", dispatches.c.subject == bindparam("job_id")
)


# The users and projects of whom as many jobs run as may.
_HELD_BACK = text("""
    SELECT kind, name FROM quotas WHERE running IS NOT NULL AND running <= (
        SELECT count(*) FROM jobs WHERE status = ANY(CAST(:held AS text[]))
            AND CASE quotas.kind WHEN 'user' THEN jobs.owner ELSE jobs.project END = quotas.name
    )
""")


# Whether the job to which an updated one yields belongs to the same project.
_WAITING = jobs.alias("waiting")
_IS_OF_ITS_PROJECT = (
    select(_WAITING.c.id)
    .where(_WAITING.c.id == jobs.c.yields_to, _WAITING.c.project == jobs.c.project)
    .correlate(jobs)
    .exists()
    .label("is_of_its_project")
)


class LeaseQueries(Session):
    """The part of a JobStore that decides who works on a job."""

    def renew(self, job_id: str, token: str, lease: timedelta) -> Renewal:
        held = update(jobs).where(jobs.c.id == job_id, jobs.c.token == token, jobs.c.token != "")
        renewed = held.values(lease_until=NOW + interval(lease))
        told = renewed.returning(jobs.c.status, jobs.c.yields_to, _IS_OF_ITS_PROJECT)
        with self._statements() as connection:
            row = connection.execute(told).first()
        if row is None:
            raise LeaseLost(job_id)
        room_for = None if row.yields_to is None else in_words(row.yields_to, row.is_of_its_project)
        return Renewal(JobStatus(row.status), room_for)

    def expired(self) -> Iterable[Job]:
        wanted = select(jobs).where(jobs.c.status.in_(HELD), is_over()).order_by(jobs.c.id)
        with self._statements() as connection:
            found = jobs_of_rows(connection, connection.execute(wanted).all())
        for job in found:
            if isinstance(job, UnreadableJob):
                log.warning("job_unreadable", job_id=job.id, problem=job.problem)
        return [job for job in found if isinstance(job, Job)]

    def beat(self, lease: timedelta) -> None:
        silence = NOW - pulse.c.beat_at
        was_away = or_(silence > lease / 2, silence < timedelta(0))
        longest, quiet_until = interval(lease / 2), NOW + interval(lease)
        # The row is missing after all tables were emptied.
        beat = insert(pulse).values(id=1, beat_at=NOW, longest_silence=longest, quiet_until=quiet_until)
        again = {
            "beat_at": NOW,
            "longest_silence": longest,
            "quiet_until": case((was_away, quiet_until), else_=pulse.c.quiet_until),
        }
        # After the clock was set back: a lease that ends more than four leases from now is cut to one.
        too_long = update(jobs).where(jobs.c.status.in_(HELD), jobs.c.lease_until > NOW + 4 * lease)
        with self._transaction() as connection:
            connection.execute(beat.on_conflict_do_update(index_elements=["id"], set_=again))
            connection.execute(too_long.values(lease_until=NOW + interval(lease)))

    def waiting(
        self, room: Mapping[str, int] | None = None, but_not: Collection[tuple[str, int]] = ()
    ) -> Sequence[Dispatch]:
        if room is None:
            room = dict.fromkeys(all_queues(self.queues_of_several_hosts()), MOST_WAITING)
        with self._statements() as connection:
            held_back = connection.execute(_HELD_BACK, {"held": list(HELD)}).all()
            of_jobs = _waiting(connection, room, but_not, [(row.kind, row.name) for row in held_back])
            return [*of_jobs, *uploads.waiting(connection)]

    def queue_counts(self) -> Sequence[QueueCount]:
        with self._statements() as connection:
            return [QueueCount(*row) for row in connection.execute(_queue_counts())]

    def queues_of_several_hosts(self) -> Collection[str]:
        # Bounds that the index `jobs_queued` can use, whatever the database's order of characters.
        among = and_(jobs.c.queue >= SEVERAL_HOSTS, jobs.c.queue < "gaitway-i")
        wanted = select(jobs.c.queue).where(jobs.c.status == "queued", among).distinct()
        with self._statements() as connection:
            return list(connection.execute(wanted).scalars())

    def undispatched(self) -> Sequence[Dispatch]:
        of_jobs = dispatches.outerjoin(jobs, dispatches.c.subject.collate("C") == jobs.c.id)
        wanted = select(dispatches).select_from(of_jobs).where(_is_due())
        with self._statements() as connection:
            found = connection.execute(wanted.order_by(dispatches.c.created_at).limit(1000)).all()
        return [Dispatch(row.task, row.subject, row.attempt) for row in found]

    def dispatched(self, dispatches: Sequence[Dispatch]) -> None:
        if dispatches:
            with self._statements() as connection:
                connection.execute(_REMOVE, [asdict(dispatch) for dispatch in dispatches])


def in_words(job_id: str, is_of_its_project: bool) -> str:
    """A job, for readers of one project: nothing of the jobs of others is shown to them."""
    return f"job {job_id}" if is_of_its_project else "a job of another project"


def is_over() -> Any:
    """Whether a held job may be taken from its attempt.

    False while the last beat is too old, and for a lease after that: nobody could renew meanwhile.
    """
    is_watched = and_(pulse.c.quiet_until < NOW, NOW - pulse.c.beat_at <= pulse.c.longest_silence)
    is_run_out = or_(jobs.c.lease_until.is_(None), jobs.c.lease_until < NOW)
    return and_(is_run_out, select(is_watched).scalar_subquery())


def forget_dispatch(connection: Connection, job_id: str) -> None:
    connection.execute(_FORGET, {"job_id": job_id})


def _waiting(
    connection: Connection,
    room: Mapping[str, int],
    but_not: Collection[tuple[str, int]],
    held_back: Collection[tuple[str, str]],
) -> Sequence[Dispatch]:
    """For each queue the oldest jobs that may begin, as many as it has room for, in the order of `room`.

    held_back: users and projects, by kind and name, whose jobs may not begin now.

    Its rows are found by the index `jobs_queued`: however many wait, only these are read.
    """
    wanted = func.unnest(bindparam("names", type_=ARRAY(Text)), bindparam("rooms", type_=ARRAY(Integer)))
    wanted = wanted.table_valued("name", "room", with_ordinality="place").render_derived("wanted")
    attempt, no = jobs.c.num_attempts + 1, bindparam("but_not", type_=ARRAY(Text))
    is_wanted = func.concat(jobs.c.id, " ", attempt) != all_(no)
    due = select(jobs.c.id, attempt.label("attempt")).where(jobs.c.status == "queued", _is_due(), is_wanted)
    if users := [name for kind, name in held_back if kind == "user"]:
        due = due.where(func.coalesce(jobs.c.owner, "").not_in(users))
    if projects := [name for kind, name in held_back if kind == "project"]:
        due = due.where(jobs.c.project.not_in(projects))
    of_queue = due.where(jobs.c.queue == wanted.c.name).order_by(jobs.c.queue, jobs.c.id).limit(wanted.c.room)
    found = of_queue.lateral("found")
    ordered = select(found).select_from(wanted.join(found, true())).order_by(wanted.c.place, found.c.id)
    without = due.where(jobs.c.queue.is_(None)).order_by(jobs.c.id).limit(max(room.values(), default=0))
    parameters = {
        "names": list(room),
        "rooms": list(room.values()),
        "but_not": [f"{job_id} {attempt}" for job_id, attempt in but_not],
    }
    rows = [*connection.execute(ordered, parameters), *connection.execute(without, parameters)]
    return [Dispatch("attempt", *row) for row in rows]


def _is_due() -> Any:
    """Whether a job may be tried now.

    A `not_before` further ahead than the longest pause was set before the clock was set back; it is ignored.
    """
    not_yet = and_(jobs.c.not_before > NOW, jobs.c.not_before <= NOW + max(PAUSES))
    return or_(jobs.c.not_before.is_(None), not_(not_yet))


def _queue_counts() -> Any:
    """Rows of a `QueueCount`, in one statement: a job counts once, however it changes meanwhile."""
    is_queued = and_(jobs.c.status == "queued", _is_due())
    last = and_(attempts.c.job_id == jobs.c.id, attempts.c.number == jobs.c.num_attempts)
    since = func.coalesce(attempts.c.ended_at, jobs.c.created_at)
    of_jobs = (
        select(
            jobs.c.queue,
            func.count().filter(is_queued),
            func.count().filter(jobs.c.status.in_(HELD)),
            age_s(func.min(since).filter(is_queued)),
        )
        .select_from(jobs.outerjoin(attempts, last))
        .where(jobs.c.status.in_(UNFINISHED))
        .group_by(jobs.c.queue)
        .having(func.count().filter(or_(is_queued, jobs.c.status.in_(HELD))) > 0)
    )
    sent = union_all(
        *(
            select(table.uploads.c.created_at).where(table.uploads.c.status == "validating")
            for table in uploads.TABLES.values()
        )
    ).subquery()
    of_uploads = select(literal(MODELS), func.count(), literal(0), age_s(func.min(sent.c.created_at))).having(
        func.count() > 0
    )
    return union_all(of_jobs, of_uploads)
