"""Listings that stay fast among a million jobs, whatever their filters.

Their pages end at a number of rows, or at a number of bytes: rows may be long. Cursors, with which readers
continue a listing, come from clients, so they are checked.
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, Subquery, Table, func, or_, select

from core.adapters.postgres.tables import jobs
from core.errors import JobNotFound, Problem, Rejected
from core.jobs.job import check_job_id
from core.jobs.store import JobQuery
from core.jobs.workers import WORKER_NAME
from core.user_models.record import ModelRecord

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MODEL = re.compile(r"([0-9]{1,17})-(sha256:[0-9a-f]{64})")
# How many of the newest jobs are checked one by one, which takes 5 ms.
_NEAR = 20_000
_MOST_BYTES = 2**22
_COLUMNS = ("status", "kind", "environment", "name")


def check_cursor(cursor: str) -> str:
    """The id of the last job of a page; raises Rejected if the cursor is not a job's id."""
    try:
        return check_job_id(cursor)
    except JobNotFound:
        raise _refusal() from None


def model_cursor(record: ModelRecord) -> str:
    """When the last model of a page was sent, in microseconds since 1970, and its id."""
    return f"{(record.created_at - _EPOCH) // timedelta(microseconds=1)}-{record.id}"


def check_model_cursor(cursor: str) -> tuple[datetime, str]:
    """The moment and the id of a cursor made by `model_cursor`. Raises Rejected."""
    found = _MODEL.fullmatch(cursor)
    if found is None:
        raise _refusal()
    return _EPOCH + timedelta(microseconds=int(found[1])), found[2]


def check_worker_cursor(cursor: str) -> str:
    """The name of the last worker of a page; raises Rejected if no worker can have this name."""
    if re.fullmatch(WORKER_NAME, cursor) is None:
        raise _refusal()
    return cursor


def _refusal() -> Rejected:
    sentence = "The cursor is not one that this listing gave; leave it out to begin with the first page."
    return Rejected(sentence, [Problem("/cursor", sentence)])


def newest(connection: Connection, query: JobQuery, before: str | None, limit: int) -> Sequence[Row[Any]]:
    """The newest jobs that match, of those with ids below `before`; fewer where they are long (`by_bytes`).

    A single condition has an index in the order of ids. Few jobs or none may match several conditions, which
    the planner cannot know: it would walk through all jobs. So the newest jobs are tried first. If too few of
    them match, matches are rare, and all of them are collected from the indexes before they are sorted.
    """
    conditions = _conditions(query, jobs)
    if len(conditions) > 1 or query.labels or query.search:
        found = connection.execute(_among_the_newest(query, before, limit)).all()
        if has_more(found, limit - 1) or not _has_more(connection, before):
            return found
        return connection.execute(_collected(query, before, limit)).all()
    wanted = select(jobs).where(*conditions, *_below(before)).order_by(jobs.c.id.desc()).limit(limit)
    return connection.execute(by_bytes(wanted, _size(jobs), "id")).all()


def _size(table: Table | Subquery) -> ColumnElement[int]:
    return func.octet_length(table.c.spec) + func.coalesce(func.octet_length(table.c.progress), 0)


def _among_the_newest(query: JobQuery, before: str | None, limit: int) -> Any:
    near = select(jobs).where(*_below(before)).order_by(jobs.c.id.desc()).limit(_NEAR).subquery("near")
    wanted = select(near).where(*_conditions(query, near)).order_by(near.c.id.desc()).limit(limit)
    return by_bytes(wanted, _size(near), "id")


def _has_more(connection: Connection, before: str | None) -> bool:
    """Whether there are jobs beyond the newest."""
    beyond = select(jobs.c.id).where(*_below(before)).order_by(jobs.c.id.desc()).offset(_NEAR).limit(1)
    return connection.execute(beyond).first() is not None


def _collected(query: JobQuery, before: str | None, limit: int) -> Any:
    matches = select(jobs.c.id).where(*_conditions(query, jobs), *_below(before)).cte("matches")
    matches = matches.prefix_with("MATERIALIZED")
    wanted = select(jobs).join(matches, jobs.c.id == matches.c.id).order_by(jobs.c.id.desc()).limit(limit)
    return by_bytes(wanted, _size(jobs), "id")


def _conditions(query: JobQuery, table: Table | Subquery) -> list[ColumnElement[bool]]:
    wanted = [(name, getattr(query, name)) for name in _COLUMNS]
    found: list[ColumnElement[bool]] = [table.c[name] == value for name, value in wanted if value is not None]
    if query.labels:
        found.append(table.c.labels.contains(query.labels))
    if query.search:
        texts = (table.c.name, table.c.environment)
        found.append(or_(*(text.icontains(query.search, autoescape=True) for text in texts)))
    return found


def _below(before: str | None) -> list[ColumnElement[bool]]:
    return [] if before is None else [jobs.c.id < before]


def by_bytes(wanted: Select[Any], size: ColumnElement[int], *order: str) -> Select[Any]:
    """As many of the first rows as have some mebibytes, at least one. order: columns, each descending.

    Each row also says how many there would be: `page_found`.
    """
    found = wanted.add_columns(size.label("page_bytes")).subquery("found")
    downwards = [found.c[name].desc() for name in order]
    up_to = func.sum(found.c.page_bytes).over(order_by=downwards, rows=(None, 0))
    sums = select(found, up_to.label("page_sum"), func.count().over().label("page_found")).subquery("sums")
    within = sums.c.page_sum - sums.c.page_bytes < _MOST_BYTES
    return select(sums).where(within).order_by(*(sums.c[name].desc() for name in order))


def has_more(found: Sequence[Row[Any]], kept: int) -> bool:
    """Whether there were more rows than are kept of these, which `by_bytes` gave."""
    return bool(found) and found[0].page_found > kept
