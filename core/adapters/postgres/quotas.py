"""Quotas of users and projects, and sums over what their jobs have and used."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, and_, delete, func, or_, select
from sqlalchemy.dialects.postgresql import insert

from core.accounts.principal import Ownership
from core.accounts.store import Actor
from core.adapters.postgres.accounts import note_audit
from core.adapters.postgres.engine import Session
from core.adapters.postgres.rows import HELD, columns
from core.adapters.postgres.tables import NOW, UNFINISHED, jobs, quotas, usage
from core.adapters.postgres.usage import OWNER, PROJECT, concerning, running_attempts, stored_bytes
from core.errors import QuotaNotFound
from core.jobs.quotas import ALL_PARTS, Part, QuotaUse, Use, first_hour, over_queue, refuse
from core.jobs.turns import Quota, Quotas
from core.jobs.usage import hours_between

_CONCERNING = or_(
    and_(quotas.c.kind == "project", quotas.c.name == PROJECT),
    and_(quotas.c.kind == "user", quotas.c.name == OWNER),
)
_LIMITS = select(quotas).where(_CONCERNING, quotas.c.queued.is_not(None))
# In one order, so that two submissions never wait for each other.
_LOCKED_LIMITS = _LIMITS.order_by(quotas.c.kind, quotas.c.name).with_for_update()


class QuotaQueries(Session):
    """A QuotaStore."""

    def quotas(self) -> Quotas:
        with self._statements() as connection:
            return all_quotas(connection)

    def quota_uses(
        self, whose: Ownership | None = None, parts: Collection[Part] = ALL_PARTS
    ) -> Sequence[QuotaUse]:
        wanted = select(quotas).order_by(quotas.c.kind, quotas.c.name)
        who: dict[str, Any] = {}
        if whose is not None:
            wanted, who = wanted.where(_CONCERNING), _who(whose)
        with self._statements() as connection:
            set_ones = connection.execute(wanted, who).all()
            if whose is not None:
                parts = [part for part in parts if any(getattr(one, part) is not None for one in set_ones)]
            sums = _Sums(connection, who, parts if set_ones else ())
        return [
            QuotaUse(one.kind, one.name, _quota(columns(one)), sums.of(one.kind, one.name))
            for one in set_ones
        ]

    def set_quota(self, kind: str, name: str, quota: Quota, actor: Actor) -> None:
        values = asdict(quota)
        write = insert(quotas).values(kind=kind, name=name, **values)
        with self._transaction() as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["kind", "name"], set_=values))
            note_audit(connection, actor, "quota.set", f"{kind} {name}", **values)

    def remove_quota(self, kind: str, name: str, actor: Actor) -> None:
        gone = delete(quotas).where(quotas.c.kind == kind, quotas.c.name == name).returning(quotas.c.name)
        with self._transaction() as connection:
            if connection.execute(gone).first() is None:
                raise QuotaNotFound(kind, name)
            note_audit(connection, actor, "quota.removed", f"{kind} {name}")


def all_quotas(connection: Connection) -> Quotas:
    return quotas_of(columns(row) for row in connection.execute(select(quotas)))


def quotas_of(found: Iterable[Mapping[str, Any]]) -> Quotas:
    """Those of rows of the table."""
    return Quotas({(row["kind"], row["name"]): _quota(row) for row in found})


def limits_queue(connection: Connection, whose: Ownership) -> bool:
    """Whether `check_queue` may refuse a job of theirs."""
    return connection.execute(_LIMITS.limit(1), _who(whose)).first() is not None


def check_queue(connection: Connection, whose: Ownership) -> None:
    """Raises QuotaExceeded if as many jobs of theirs are queued as may be.

    Until the transaction ends, others that add jobs under the same quota wait here: none is passed.
    """
    for row in connection.execute(_LOCKED_LIMITS, _who(whose)).all():
        party = jobs.c.project if row.kind == "project" else jobs.c.owner
        queued = select(func.count()).where(jobs.c.status == "queued", party == row.name)
        use = Use(queued=connection.execute(queued).scalar_one())
        refuse(over_queue(QuotaUse(row.kind, row.name, _quota(columns(row)), use)))


def _who(whose: Ownership) -> dict[str, Any]:
    return {"owner": whose.owner, "project": whose.project}


def _quota(row: Mapping[str, Any]) -> Quota:
    return Quota(
        row["weight"],
        row["running"],
        row["queued"],
        row["gpu_hours"],
        row["bytes"],
        row["highest_priority"],
    )


class _Sums:
    """What each user has in each project. who: of one owner and one project alone; empty: of all."""

    def __init__(self, connection: Connection, who: dict[str, Any], parts: Collection[Part]) -> None:
        self._hours: dict[tuple[str, str], dict[datetime, float]] = defaultdict(dict)
        counts = _counts(connection, who) if {"queued", "running"} & {*parts} else ()
        stored = stored_bytes(connection, who) if "bytes" in parts else ()
        self._counts = {(row.project, row.owner): row for row in counts}
        self._bytes = {(row.project, row.owner): row.bytes for row in stored}
        if "gpu_hours" in parts:
            self._read_hours(connection, who)

    def of(self, kind: str, name: str) -> Use:
        """The sum over those pairs of a project and a user that have it."""
        place = 0 if kind == "project" else 1
        counts = [row for who, row in self._counts.items() if who[place] == name]
        hours = defaultdict[datetime, float](float)
        for who, own in self._hours.items():
            if who[place] == name:
                for hour, amount in own.items():
                    hours[hour] += amount
        return Use(
            running=sum(row.running for row in counts),
            queued=sum(row.queued for row in counts),
            gpu_hours=dict(hours),
            bytes=sum(number for who, number in self._bytes.items() if who[place] == name),
        )

    def _read_hours(self, connection: Connection, who: dict[str, Any]) -> None:
        now = connection.execute(select(NOW)).scalar_one()
        since = first_hour(now)
        wanted = (
            select(
                usage.c.project, usage.c.owner, usage.c.hour, func.sum(usage.c.gpu_seconds).label("seconds")
            )
            .where(usage.c.hour >= since, usage.c.gpu_seconds > 0, *concerning(usage, who))
            .group_by(usage.c.project, usage.c.owner, usage.c.hour)
        )
        for row in connection.execute(wanted, who):
            self._add(row.project, row.owner, row.hour, row.seconds)
        for attempt in running_attempts(connection):
            if attempt.num_gpus:
                for hour, seconds in hours_between(max(since, attempt.started_at), now):
                    self._add(attempt.project, attempt.owner, hour, seconds * attempt.num_gpus)

    def _add(self, project: str, owner: str, hour: datetime, gpu_seconds: float) -> None:
        own = self._hours[project, owner]
        own[hour] = own.get(hour, 0.0) + gpu_seconds / 3600


def _counts(connection: Connection, who: dict[str, Any]) -> Iterable[Any]:
    owner = func.coalesce(jobs.c.owner, "").label("owner")
    wanted = (
        select(
            jobs.c.project,
            owner,
            func.count().filter(jobs.c.status == "queued").label("queued"),
            func.count().filter(jobs.c.status.in_(HELD)).label("running"),
        )
        .where(jobs.c.status.in_(UNFINISHED), *concerning(jobs, who))
        .group_by(jobs.c.project, owner)
    )
    return connection.execute(wanted, who).all()
