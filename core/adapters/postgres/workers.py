"""The workers that announced themselves, each until its time is over."""

from collections.abc import Sequence
from datetime import timedelta

import structlog
from pydantic import ValidationError
from sqlalchemy import Connection, delete, select
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres.rows import interval
from core.adapters.postgres.tables import NOW, workers
from core.jobs.store import WorkerInfo

log = structlog.get_logger()


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
    """All workers that this version can read; the others are logged and left out."""
    wanted = select(workers.c.said).where(workers.c.gone_at > NOW).order_by(workers.c.name)
    found: list[WorkerInfo] = []
    for text in connection.execute(wanted).scalars():
        try:
            found.append(WorkerInfo.model_validate_json(text))
        except ValidationError as error:
            log.warning("worker_unreadable", problem=str(error))
    return found


def forget_gone(connection: Connection) -> None:
    connection.execute(delete(workers).where(workers.c.gone_at <= NOW))
