"""Leases: how long an attempt holds a job, by the database's clock, and when a job may be taken from it."""

from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from sqlalchemy import Connection, and_, case, or_, select, update
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import loading, rows
from core.adapters.postgres.tables import NOW, jobs, pulse
from core.errors import LeaseLost
from core.jobs.job import Job
from core.jobs.status import JobStatus

HELD = tuple(status.value for status in JobStatus if status.is_held)


def renew(connection: Connection, job_id: str, token: str, lease: timedelta) -> JobStatus:
    """Prolong the lease of the attempt with this token; the job's status. Raises LeaseLost."""
    status = connection.execute(
        update(jobs)
        .where(jobs.c.id == job_id, jobs.c.token == token, jobs.c.token != "")
        .values(lease_until=NOW + rows.interval(lease))
        .returning(jobs.c.status)
    ).scalar()
    if status is None:
        raise LeaseLost(job_id)
    return JobStatus(status)


def expired(connection: Connection) -> Sequence[Job]:
    """Every readable job that may be taken from its attempt, oldest first."""
    wanted = select(jobs).where(jobs.c.status.in_(HELD), is_over()).order_by(jobs.c.id)
    return loading.without_unreadable(loading.of_rows(connection, connection.execute(wanted).all()))


def is_over() -> Any:
    """Whether a held job may be taken from its attempt.

    False while the last beat is too old, and for a lease after that: nobody could renew meanwhile.
    """
    is_watched = and_(pulse.c.quiet_until < NOW, NOW - pulse.c.beat_at <= pulse.c.longest_silence)
    is_run_out = or_(jobs.c.lease_until.is_(None), jobs.c.lease_until < NOW)
    return and_(is_run_out, select(is_watched).scalar_subquery())


def beat(connection: Connection, lease: timedelta) -> None:
    """Record that leases are watched; after a silence of half a lease, attempts get a lease to renew."""
    silence = NOW - pulse.c.beat_at
    was_away = or_(silence > lease / 2, silence < timedelta(0))
    longest, quiet_until = rows.interval(lease / 2), NOW + rows.interval(lease)
    connection.execute(
        # The row is missing after all tables were emptied.
        insert(pulse)
        .values(id=1, beat_at=NOW, longest_silence=longest, quiet_until=quiet_until)
        .on_conflict_do_update(
            index_elements=["id"],
            set_={
                "beat_at": NOW,
                "longest_silence": longest,
                "quiet_until": case((was_away, quiet_until), else_=pulse.c.quiet_until),
            },
        )
    )
    # After the clock was set back: a lease that ends more than four leases from now is cut to one.
    connection.execute(
        update(jobs)
        .where(jobs.c.status.in_(HELD), jobs.c.lease_until > NOW + 4 * lease)
        .values(lease_until=NOW + rows.interval(lease))
    )
