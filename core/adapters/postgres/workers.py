"""The workers that announced themselves, each until its time is over."""

from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import structlog
from pydantic import ValidationError
from sqlalchemy import Connection, and_, delete, func, select
from sqlalchemy.dialects.postgresql import aggregate_order_by, insert

from core.adapters.postgres.engine import DriverStatement, Session
from core.adapters.postgres.listing import check_worker_cursor
from core.adapters.postgres.rows import HELD, interval
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
    select(workers.c.name, workers.c.document, _RUNNING.c.jobs)
    .outerjoin(_RUNNING, _RUNNING.c.worker == workers.c.name)
    .where(workers.c.gone_at > NOW)
    .order_by(workers.c.name)
)
_ALL_PRESENT = DriverStatement(_PRESENT)


class WorkerQueries(Session):
    """A WorkerStore."""

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        written = {"document": worker.model_dump_json(), "gone_at": NOW + interval(ttl)}
        write = insert(workers).values(name=worker.name, **written)
        with self._statements() as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["name"], set_=written))

    def withdraw(self, name: str) -> None:
        with self._statements() as connection:
            connection.execute(delete(workers).where(workers.c.name == name))

    def workers(self) -> Sequence[WorkerInfo]:
        with self._statements() as connection:
            return present(connection)

    def list_workers(self, *, cursor: str | None = None, limit: int = 50) -> WorkerPage:
        after = None if cursor is None else check_worker_cursor(cursor)
        wanted = _PRESENT if after is None else _PRESENT.where(workers.c.name > after)
        with self._statements() as connection:
            rows = connection.execute(wanted.limit(limit + 1)).mappings().all()
        return WorkerPage(_readable(rows[:limit]), rows[limit - 1]["name"] if len(rows) > limit else None)


def present(connection: Connection) -> list[WorkerInfo]:
    """Those whose time is not over, ordered by name."""
    return _readable(_ALL_PRESENT.rows(connection, {}))


def _readable(rows: Sequence[Mapping[Any, Any]]) -> list[WorkerInfo]:
    """The workers that this version can read; the others are logged and left out."""
    found: list[WorkerInfo] = []
    for row in rows:
        try:
            worker = WorkerInfo.model_validate_json(row["document"])
            # It may have claimed another job than that of its message.
            own = row["jobs"][0] if row["jobs"] else worker.job
            found.append(worker.model_copy(update={"jobs": tuple(row["jobs"] or ()), "job": own}))
        except ValidationError as error:
            log.warning("worker_unreadable", problem=str(error))
    return found
