"""Listings that stay fast among a million jobs, whatever their filters."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Subquery, Table, func, or_, select

from core.adapters.postgres import pages
from core.adapters.postgres.tables import jobs
from core.jobs.store import JobQuery

# How many of the newest jobs are checked one by one, which takes 5 ms.
_NEAR = 20_000
_COLUMNS = ("status", "kind", "environment", "name")


def newest(connection: Connection, query: JobQuery, before: str | None, limit: int) -> Sequence[Row[Any]]:
    """The newest jobs that match, of those with ids below `before`; fewer where they are long (`pages`).

    A single condition has an index in the order of ids. Few jobs or none may match several conditions, which
    the planner cannot know: it would walk through all jobs. So the newest jobs are tried first. If too few of
    them match, matches are rare, and all of them are collected from the indexes before they are sorted.
    """
    conditions = _conditions(query, jobs)
    if len(conditions) > 1 or query.labels or query.search:
        found = connection.execute(_among_the_newest(query, before, limit)).all()
        if pages.has_more(found, limit - 1) or not _has_more(connection, before):
            return found
        return connection.execute(_collected(query, before, limit)).all()
    wanted = select(jobs).where(*conditions, *_below(before)).order_by(jobs.c.id.desc()).limit(limit)
    return connection.execute(pages.by_bytes(wanted, _size(jobs), "id")).all()


def _size(table: Table | Subquery) -> ColumnElement[int]:
    return func.octet_length(table.c.spec) + func.coalesce(func.octet_length(table.c.progress), 0)


def _among_the_newest(query: JobQuery, before: str | None, limit: int) -> Any:
    near = select(jobs).where(*_below(before)).order_by(jobs.c.id.desc()).limit(_NEAR).subquery("near")
    wanted = select(near).where(*_conditions(query, near)).order_by(near.c.id.desc()).limit(limit)
    return pages.by_bytes(wanted, _size(near), "id")


def _has_more(connection: Connection, before: str | None) -> bool:
    """Whether there are jobs beyond the newest."""
    beyond = select(jobs.c.id).where(*_below(before)).order_by(jobs.c.id.desc()).offset(_NEAR).limit(1)
    return connection.execute(beyond).first() is not None


def _collected(query: JobQuery, before: str | None, limit: int) -> Any:
    matches = select(jobs.c.id).where(*_conditions(query, jobs), *_below(before)).cte("matches")
    matches = matches.prefix_with("MATERIALIZED")
    wanted = select(jobs).join(matches, jobs.c.id == matches.c.id).order_by(jobs.c.id.desc()).limit(limit)
    return pages.by_bytes(wanted, _size(jobs), "id")


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
