"""The records of users' own models and of clip files."""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Generic

import structlog
from pydantic import ValidationError
from sqlalchemy import Column, Connection, Engine, Row, Table, delete, func, select, tuple_, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.exc import IntegrityError

from core.accounts.principal import Ownership
from core.adapters.postgres import listing
from core.adapters.postgres.engine import Session
from core.adapters.postgres.errors import Breaker
from core.adapters.postgres.listing import check_upload_cursor, upload_cursor
from core.adapters.postgres.rows import columns, sweeps_naming, users_of, words
from core.adapters.postgres.tables import (
    NOW,
    clip_file_projects,
    clip_files,
    dispatches,
    model_projects,
    models,
)
from core.adapters.timing import Observe
from core.clips.record import CLIPS
from core.jobs.store import Dispatch
from core.uploads.record import KindName, Record, UploadKind, UploadPage
from core.user_models.record import MODELS

log = structlog.get_logger()

_UNREADABLE = "This version cannot read what was found out about it; send it again."


@dataclass(frozen=True)
class UploadTables:
    """uploads: a row for each. projects: those that have each, which `upload` of it names."""

    uploads: Table
    projects: Table
    upload: Column[Any]


TABLES: Mapping[KindName, UploadTables] = {
    MODELS.name: UploadTables(models, model_projects, model_projects.c.model_id),
    CLIPS.name: UploadTables(clip_files, clip_file_projects, clip_file_projects.c.clip_file_id),
}


class UploadQueries(Session, Generic[Record]):
    """An UploadStore."""

    def __init__(self, kind: UploadKind[Record], engine: Engine, observe: Observe, breaker: Breaker) -> None:
        super().__init__(engine, observe, breaker)
        self.kind = kind
        self._tables = TABLES[kind.name]
        self._uploads = self._tables.uploads

    def find(self, upload_id: str) -> Record:
        with self._statements() as connection:
            row = connection.execute(select(self._uploads).where(self._uploads.c.id == upload_id)).first()
        if row is None:
            raise self.kind.missing(upload_id)
        return self._record(row)

    def add(self, record: Record) -> None:
        values = self._values(record)
        write = insert(self._uploads).values(id=record.id, **values)
        dispatch = insert(dispatches).values(
            task=self.kind.name, subject=record.id, attempt=0, created_at=NOW
        )
        with self._transaction() as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["id"], set_=values))
            if record.status == "validating":
                connection.execute(dispatch.on_conflict_do_nothing())

    def dispatched(self, upload_id: str) -> None:
        with self._statements() as connection:
            connection.execute(self._dispatch_of(upload_id))

    def rename(self, upload_id: str, name: str) -> None:
        with self._statements() as connection:
            self._change(connection, upload_id, {"name": name})

    def settle(self, record: Record) -> None:
        values = self._values(record)
        del values["name"]  # Somebody may have sent it by another one meanwhile.
        with self._transaction() as connection:
            self._change(connection, record.id, values)

    def delete(self, upload_id: str) -> None:
        with self._transaction() as connection:
            self._forget(connection, upload_id)

    def num_waiting(self) -> int:
        with self._statements() as connection:
            return len(_waiting(connection, self.kind.name))

    def all(self) -> Sequence[Record]:
        with self._statements() as connection:
            found = connection.execute(select(self._uploads).order_by(self._uploads.c.id))
            return [self._record(row) for row in found]

    def list(
        self,
        *,
        cursor: str | None = None,
        limit: int = 50,
        name: str | None = None,
        projects: Collection[str] | None = None,
        owner: str | None = None,
    ) -> UploadPage[Record]:
        table, its = self._uploads.c, self._tables.projects.c
        wanted = select(self._uploads).order_by(table.created_at.desc(), table.id.desc()).limit(limit + 1)
        if cursor is not None:  # Ids order those of one moment.
            wanted = wanted.where(tuple_(table.created_at, table.id) < tuple_(*check_upload_cursor(cursor)))
        if name is not None:
            wanted = wanted.where(table.name == name)
        if projects is not None or owner is not None:
            has = select(its.project).where(self._tables.upload == table.id)
            has = has if projects is None else has.where(its.project.in_(projects))
            has = has if owner is None else has.where(its.owner == owner)
            wanted = wanted.where(has.exists())
        size = func.coalesce(func.octet_length(table.description), 0)
        with self._statements() as connection:
            found = connection.execute(listing.by_bytes(wanted, size, "created_at", "id")).all()
        page = [self._record(row) for row in found[:limit]]
        more = listing.has_more(found, len(page))
        return UploadPage(page, upload_cursor(page[-1]) if more else None)

    def claim(self, upload_id: str, ownership: Ownership) -> None:
        new = insert(self._tables.projects).values(
            {self._tables.upload: upload_id, "project": ownership.project, "owner": ownership.owner}
        )
        try:
            with self._statements() as connection:
                connection.execute(new.on_conflict_do_nothing())
        except IntegrityError:
            raise self.kind.missing(upload_id) from None

    def owners_of(self, upload_ids: Collection[str]) -> Mapping[str, Sequence[Ownership]]:
        # PostgreSQL takes no U+0000, and no id has one.
        ids = [one for one in upload_ids if "\0" not in one]
        its = self._tables.projects.c
        wanted = select(self._tables.upload.label("upload"), its.project, its.owner)
        wanted = wanted.where(self._tables.upload.in_(ids)).order_by(its.project)
        found: dict[str, list[Ownership]] = defaultdict(list)
        with self._statements() as connection:
            for row in connection.execute(wanted):
                found[row.upload].append(Ownership(row.owner, row.project))
        return found

    def release(self, upload_id: str, projects: Collection[str]) -> bool:
        table, is_its = self._tables.projects, self._tables.upload == upload_id
        # With `claim` and `hold_clips`: whoever comes second waits, and then sees what the first one did.
        held = select(self._uploads.c.id).where(self._uploads.c.id == upload_id).with_for_update()
        with self._transaction() as connection:
            if connection.execute(held).first() is None:
                raise self.kind.missing(upload_id)
            users = connection.execute(users_of(upload_id)).all()
            needed = [job.id for job in users if job.project in projects]
            to_come = connection.execute(sweeps_naming(upload_id, projects)).scalars().all()
            if needed or to_come:
                raise self.kind.in_use(upload_id, needed, to_come)
            connection.execute(delete(table).where(is_its, table.c.project.in_(projects)))
            if users or connection.execute(select(table.c.project).where(is_its)).first() is not None:
                return False
            self._forget(connection, upload_id)
            return True

    def _forget(self, connection: Connection, upload_id: str) -> None:
        connection.execute(delete(self._uploads).where(self._uploads.c.id == upload_id))
        connection.execute(self._dispatch_of(upload_id))

    def _change(self, connection: Connection, upload_id: str, values: dict[str, Any]) -> None:
        """Raises the kind's `missing`."""
        its = self._uploads.c.id
        changed = connection.execute(
            update(self._uploads).where(its == upload_id).values(values).returning(its)
        )
        if changed.first() is None:
            raise self.kind.missing(upload_id)

    def _dispatch_of(self, upload_id: str) -> Any:
        is_its = dispatches.c.subject == upload_id
        return delete(dispatches).where(dispatches.c.task == self.kind.name, is_its)

    def _values(self, record: Record) -> dict[str, Any]:
        description = record.description
        return {
            **record.model_dump(exclude={"id", "description"}),
            "message": words(record.message),
            "description": None if description is None else description.model_dump_json(),
        }

    def _record(self, row: Row[Any]) -> Record:
        fields = columns(row)
        found = fields.pop("description")
        try:
            description = None if found is None else self.kind.description.model_validate_json(found)
            return self.kind.record.model_validate({**fields, "description": description})
        except ValidationError as error:
            log.warning("upload_unreadable", upload=row.id, problem=str(error))
            # Refused today: old refusals are deleted, and another version may understand this one.
            fields |= {"status": "refused", "message": _UNREADABLE, "refused_at": datetime.now(UTC)}
            return self.kind.record.model_validate({**fields, "description": None})


def waiting(connection: Connection) -> Sequence[Dispatch]:
    """The files that wait for their validation."""
    return [Dispatch(kind, upload_id) for kind in TABLES for upload_id in _waiting(connection, kind)]


def _waiting(connection: Connection, kind: KindName) -> Sequence[str]:
    table = TABLES[kind].uploads
    return connection.execute(select(table.c.id).where(table.c.status == "validating")).scalars().all()
