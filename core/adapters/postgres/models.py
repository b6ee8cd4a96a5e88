"""The records of users' own models."""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import structlog
from pydantic import ValidationError
from sqlalchemy import Connection, Row, delete, func, select, tuple_, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.exc import IntegrityError

from core.accounts.principal import Ownership
from core.adapters.postgres import listing
from core.adapters.postgres.engine import Session
from core.adapters.postgres.listing import check_model_cursor, model_cursor
from core.adapters.postgres.rows import columns, words
from core.adapters.postgres.tables import NOW, dispatches, model_projects, models
from core.errors import ModelNotFound
from core.jobs.store import Dispatch
from core.user_models.record import Description, ModelPage, ModelRecord

log = structlog.get_logger()

_UNREADABLE = "This version cannot read what was found out about it; send it again."


class ModelQueries(Session):
    """A ModelStore."""

    def find_model(self, model_id: str) -> ModelRecord:
        with self._statements() as connection:
            row = connection.execute(select(models).where(models.c.id == model_id)).first()
        if row is None:
            raise ModelNotFound(model_id)
        return _record(row)

    def add_model(self, record: ModelRecord) -> None:
        values = _values(record)
        write = insert(models).values(id=record.id, **values)
        dispatch = insert(dispatches).values(task="model", subject=record.id, attempt=0, created_at=NOW)
        with self._transaction() as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["id"], set_=values))
            if record.status == "validating":
                connection.execute(dispatch.on_conflict_do_nothing())

    def model_dispatched(self, model_id: str) -> None:
        with self._statements() as connection:
            connection.execute(_dispatch_of(model_id))

    def name_model(self, model_id: str, name: str) -> None:
        with self._statements() as connection:
            _change(connection, model_id, {"name": name})

    def settle_model(self, record: ModelRecord) -> None:
        values = _values(record)
        del values["name"]  # Somebody may have sent it by another one meanwhile.
        with self._transaction() as connection:
            _change(connection, record.id, values)

    def delete_model(self, model_id: str) -> None:
        with self._transaction() as connection:
            connection.execute(delete(models).where(models.c.id == model_id))
            connection.execute(_dispatch_of(model_id))

    def num_waiting_models(self) -> int:
        with self._statements() as connection:
            return len(waiting(connection))

    def models(self) -> Sequence[ModelRecord]:
        with self._statements() as connection:
            return [_record(row) for row in connection.execute(select(models).order_by(models.c.id))]

    def list_models(
        self,
        *,
        cursor: str | None = None,
        limit: int = 50,
        name: str | None = None,
        projects: Collection[str] | None = None,
        owner: str | None = None,
    ) -> ModelPage:
        wanted = select(models).order_by(models.c.created_at.desc(), models.c.id.desc()).limit(limit + 1)
        if cursor is not None:  # Ids order the models of one moment.
            wanted = wanted.where(
                tuple_(models.c.created_at, models.c.id) < tuple_(*check_model_cursor(cursor))
            )
        if name is not None:
            wanted = wanted.where(models.c.name == name)
        if projects is not None or owner is not None:
            has = select(model_projects.c.model_id).where(model_projects.c.model_id == models.c.id)
            has = has if projects is None else has.where(model_projects.c.project.in_(projects))
            has = has if owner is None else has.where(model_projects.c.owner == owner)
            wanted = wanted.where(has.exists())
        size = func.coalesce(func.octet_length(models.c.description), 0)
        with self._statements() as connection:
            found = connection.execute(listing.by_bytes(wanted, size, "created_at", "id")).all()
        page = [_record(row) for row in found[:limit]]
        return ModelPage(page, model_cursor(page[-1]) if listing.has_more(found, len(page)) else None)

    def claim_model(self, model_id: str, ownership: Ownership) -> None:
        new = insert(model_projects).values(
            model_id=model_id, project=ownership.project, owner=ownership.owner
        )
        try:
            with self._statements() as connection:
                connection.execute(new.on_conflict_do_nothing())
        except IntegrityError:
            raise ModelNotFound(model_id) from None

    def owners_of_models(self, model_ids: Collection[str]) -> Mapping[str, Sequence[Ownership]]:
        # PostgreSQL takes no U+0000, and no model has one.
        ids = [one for one in model_ids if "\0" not in one]
        wanted = select(model_projects).where(model_projects.c.model_id.in_(ids))
        found: dict[str, list[Ownership]] = defaultdict(list)
        with self._statements() as connection:
            for row in connection.execute(wanted.order_by(model_projects.c.project)):
                found[row.model_id].append(Ownership(row.owner, row.project))
        return found

    def release_model(self, model_id: str, projects: Collection[str]) -> bool:
        its = model_projects.c.model_id == model_id
        with self._transaction() as connection:
            connection.execute(delete(model_projects).where(its, model_projects.c.project.in_(projects)))
            return connection.execute(select(model_projects.c.project).where(its)).first() is not None


def waiting(connection: Connection) -> Sequence[Dispatch]:
    """The models that wait for their validation."""
    found = connection.execute(select(models.c.id).where(models.c.status == "validating"))
    return [Dispatch("model", row.id) for row in found]


def _change(connection: Connection, model_id: str, values: dict[str, Any]) -> None:
    """Raises ModelNotFound."""
    changed = connection.execute(
        update(models).where(models.c.id == model_id).values(values).returning(models.c.id)
    )
    if changed.first() is None:
        raise ModelNotFound(model_id)


def _dispatch_of(model_id: str) -> Any:
    return delete(dispatches).where(dispatches.c.task == "model", dispatches.c.subject == model_id)


def _values(record: ModelRecord) -> dict[str, Any]:
    description = record.description
    return {
        **record.model_dump(exclude={"id", "description"}),
        "message": words(record.message),
        "description": None if description is None else description.model_dump_json(),
    }


def _record(row: Row[Any]) -> ModelRecord:
    fields = columns(row)
    found = fields.pop("description")
    try:
        description = None if found is None else Description.model_validate_json(found)
        return ModelRecord.model_validate({**fields, "description": description})
    except ValidationError as error:
        log.warning("model_unreadable", model=row.id, problem=str(error))
        # Refused today, not earlier: old refusals are deleted, and another version may understand this one.
        fields |= {"status": "refused", "message": _UNREADABLE, "refused_at": datetime.now(UTC)}
        return ModelRecord.model_validate({**fields, "description": None})
