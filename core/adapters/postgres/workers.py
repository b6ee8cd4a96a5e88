"""The workers that announced themselves, each until its time is over."""

from collections.abc import Sequence
from datetime import timedelta
from typing import Any

import structlog
from pydantic import ValidationError
from sqlalchemy import Connection, Row, and_, delete, func, select
from sqlalchemy.dialects.postgresql import aggregate_order_by, insert

from core.adapters.postgres.leases import HELD
from core.adapters.postgres.rows import interval
from core.adapters.postgres.tables import NOW, attempts, jobs, workers
from core.jobs.workers import WorkerInfo, WorkerPage

log = structlog.get_logger()

_RUNNING = (
    select(attempts.c.worker, func.array_agg(aggregate_order_by(jobs.c.id, jobs.c.id)).label("jobs"))
    .join(jobs, and_(jobs.c.id == attempts.c.job_id, jobs.c.num_attempts == attempts.c.number))
    .where(jobs.c.status.in_(HELD))
    .group_by(attempts.c.worker)
    .subquery()
)
_PRESENT = (
    select(workers.c.name, workers.c.said, _RUNNING.c.jobs)
    .outerjoin(_RUNNING, _RUNNING.c.worker == workers.c.name)
    .where(workers.c.gone_at > NOW)
    .order_by(workers.c.name)
)


def announce(connection: Connection, worker: WorkerInfo, ttl: timedelta) -> None:
    said = {"said": worker.model_dump_json(), "gone_at": NOW + interval(ttl)}
    connection.execute(
        insert(workers)
        .values(name=worker.name, **said)
        .on_conflict_do_update(index_elements=["name"], set_=said)
    )


def withdraw(connection: Connection, name: str) -> None:
    connection.execute(delete(workers).where(workers.c.name == name))


def every(connection: Connection) -> Sequence[WorkerInfo]:
    """All workers that this version can read, by name; the others are logged and left out."""
    return _readable(connection.execute(_PRESENT).all())


def page(connection: Connection, after: str | None, limit: int) -> WorkerPage:
    """Workers whose names follow `after`. The cursor counts those that cannot be read, too."""
    wanted = _PRESENT if after is None else _PRESENT.where(workers.c.name > after)
    rows = connection.execute(wanted.limit(limit + 1)).all()
    return WorkerPage(_readable(rows[:limit]), rows[limit - 1].name if len(rows) > limit else None)


def forget_gone(connection: Connection) -> None:
    connection.execute(delete(workers).where(workers.c.gone_at <= NOW))


def _readable(rows: Sequence[Row[Any, Any, Any]]) -> list[WorkerInfo]:
    found: list[WorkerInfo] = []
    for row in rows:
        try:
            worker = WorkerInfo.model_validate_json(row.said)
            found.append(worker.model_copy(update={"jobs": tuple(row.jobs or ())}))
        except ValidationError as error:
            log.warning("worker_unreadable", problem=str(error))
    return found
