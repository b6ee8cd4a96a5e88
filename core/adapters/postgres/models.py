"""The records of users' own models."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import structlog
from pydantic import ValidationError
from sqlalchemy import Connection, Row, delete, func, select, tuple_, update
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import pages
from core.adapters.postgres.rows import columns, words
from core.adapters.postgres.tables import NOW, dispatches, models
from core.errors import ModelNotFound
from core.jobs.store import Dispatch
from core.user_models.record import Description, ModelRecord

log = structlog.get_logger()

_UNREADABLE = "This version cannot read what was found out about it; send it again."


def find(connection: Connection, model_id: str) -> ModelRecord:
    row = connection.execute(select(models).where(models.c.id == model_id)).first()
    if row is None:
        raise ModelNotFound(model_id)
    return _record(row)


def add(connection: Connection, record: ModelRecord) -> None:
    values = _values(record)
    connection.execute(
        insert(models)
        .values(id=record.id, **values)
        .on_conflict_do_update(index_elements=["id"], set_=values)
    )
    if record.status == "validating":
        connection.execute(
            insert(dispatches)
            .values(task="model", subject=record.id, attempt=0, created_at=NOW)
            .on_conflict_do_nothing()
        )


def settle(connection: Connection, record: ModelRecord) -> None:
    values = _values(record)
    del values["name"]  # Somebody may have sent it by another one meanwhile.
    _change(connection, record.id, values)


def rename(connection: Connection, model_id: str, name: str) -> None:
    _change(connection, model_id, {"name": name})


def _change(connection: Connection, model_id: str, values: dict[str, Any]) -> None:
    changed = connection.execute(
        update(models).where(models.c.id == model_id).values(values).returning(models.c.id)
    )
    if changed.first() is None:
        raise ModelNotFound(model_id)


def forget(connection: Connection, model_id: str) -> None:
    connection.execute(delete(models).where(models.c.id == model_id))
    connection.execute(
        delete(dispatches).where(dispatches.c.task == "model", dispatches.c.subject == model_id)
    )


def every(connection: Connection) -> Sequence[ModelRecord]:
    return [_record(row) for row in connection.execute(select(models).order_by(models.c.id))]


def newest(
    connection: Connection, before: tuple[datetime, str] | None, limit: int, name: str | None = None
) -> tuple[Sequence[ModelRecord], bool]:
    """The newest models, of those that were sent before this moment; ids order those of one moment. Fewer
    where their descriptions are long (`pages`), and whether there are more.

    name: only those of this name.
    """
    place = tuple_(models.c.created_at, models.c.id)
    wanted = select(models).order_by(models.c.created_at.desc(), models.c.id.desc()).limit(limit + 1)
    if before is not None:
        wanted = wanted.where(place < tuple_(*before))
    if name is not None:
        wanted = wanted.where(models.c.name == name)
    size = func.coalesce(func.octet_length(models.c.description), 0)
    found = connection.execute(pages.by_bytes(wanted, size, "created_at", "id")).all()
    return [_record(row) for row in found[:limit]], pages.has_more(found, min(len(found), limit))


def waiting(connection: Connection) -> Sequence[Dispatch]:
    found = connection.execute(select(models.c.id).where(models.c.status == "validating"))
    return [Dispatch("model", row.id) for row in found]


def _values(record: ModelRecord) -> dict[str, Any]:
    description = record.description
    return {
        **record.model_dump(exclude={"id", "description"}),
        "message": words(record.message),
        "description": None if description is None else description.model_dump_json(),
    }


def _record(row: Row[Any]) -> ModelRecord:
    said = columns(row)
    found = said.pop("description")
    try:
        description = None if found is None else Description.model_validate_json(found)
        return ModelRecord.model_validate({**said, "description": description})
    except ValidationError as error:
        log.warning("model_unreadable", model=row.id, problem=str(error))
        # Refused today, not earlier: old refusals are deleted, and another version may understand this one.
        said |= {"status": "refused", "message": _UNREADABLE, "refused_at": datetime.now(UTC)}
        return ModelRecord.model_validate({**said, "description": None})
