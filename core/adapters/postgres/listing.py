"""Listings that stay fast among a million jobs, whatever their filters.

Their pages end at a number of rows, or at a number of bytes: rows may be long. Cursors, with which readers
continue a listing, come from clients, so they are checked.
"""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from enum import Enum
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    FromClause,
    Row,
    Select,
    case,
    exists,
    func,
    or_,
    select,
    true,
    union_all,
)

from core.adapters.postgres.tables import jobs, trials
from core.errors import JobNotFound, Problem, Rejected
from core.jobs.job import check_job_id
from core.jobs.store import FOLDED, NO_SWEEP, JobQuery, Whose
from core.jobs.workers import WORKER_NAME
from core.uploads.record import Upload

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_UPLOAD = re.compile(r"([0-9]{1,17})-(sha256:[0-9a-f]{64})")
# How many of the newest jobs are checked one by one, which takes 5 ms.
_NEAR = 20_000
_MOST_BYTES = 2**22
_COLUMNS = ("status", "kind", "environment", "name")


def check_cursor(cursor: str) -> str:
    """The id of the last job of a page; raises Rejected if the cursor is not a job's id."""
    try:
        return check_job_id(cursor)
    except JobNotFound:
        raise refusal() from None


def upload_cursor(record: Upload) -> str:
    """When the last upload of a page was sent, in microseconds since 1970, and its id."""
    return f"{(record.created_at - _EPOCH) // timedelta(microseconds=1)}-{record.id}"


def check_upload_cursor(cursor: str) -> tuple[datetime, str]:
    """The moment and the id of a cursor made by `upload_cursor`. Raises Rejected."""
    found = _UPLOAD.fullmatch(cursor)
    if found is None:
        raise refusal()
    return _EPOCH + timedelta(microseconds=int(found[1])), found[2]


def check_worker_cursor(cursor: str) -> str:
    """The name of the last worker of a page; raises Rejected if no worker can have this name."""
    if re.fullmatch(WORKER_NAME, cursor) is None:
        raise refusal()
    return cursor


class Part(Enum):
    """Listings show one's own first, and then what others have."""

    OWN = "own"
    OTHERS = "others"
    ALL = "all"


Newest = Callable[[Part, str | None, int], Sequence[Row[Any]]]
_OTHERS = "others"


def own_first(
    newest: Newest, whose: Whose, cursor: str | None, limit: int
) -> tuple[Sequence[Row[Any]], str | None]:
    """A page of at most `limit` rows, and the cursor of the next one.

    newest: rows of a part below an id, at most so many, as `by_bytes` ends them. A cursor among what others
    have begins with `others`; that alone is their first page. Where nobody's own come first, all are others':
    accounts may be turned off between two pages.
    """
    among_others, before = _place(cursor)
    if whose.first is None or whose.owner is not None:
        return _page(newest, Part.ALL, before, limit)
    if among_others:
        rows, last = _page(newest, Part.OTHERS, before, limit)
        return rows, last and f"{_OTHERS}-{last}"
    rows, last = _page(newest, Part.OWN, before, limit)
    if last is not None:
        return rows, last
    if len(rows) == limit:
        return rows, _OTHERS if newest(Part.OTHERS, None, 1) else None
    others, last = _page(newest, Part.OTHERS, None, limit - len(rows))
    return [*rows, *others], last and f"{_OTHERS}-{last}"


def _place(cursor: str | None) -> tuple[bool, str | None]:
    """Whether the cursor is among what others have, and the id before which the page begins.

    Raises Rejected.
    """
    if cursor is None or cursor == _OTHERS:
        return cursor == _OTHERS, None
    before = cursor.removeprefix(f"{_OTHERS}-")
    return before != cursor, check_cursor(before)


def _page(
    newest: Newest, part: Part, before: str | None, limit: int
) -> tuple[Sequence[Row[Any]], str | None]:
    found = newest(part, before, limit + 1)
    page = found[:limit]
    return page, page[-1].id if has_more(found, len(page)) else None


def of(table: FromClause, whose: Whose, part: Part) -> list[ColumnElement[bool]]:
    """The conditions of a part of what `whose` asks for."""
    found: list[ColumnElement[bool]] = []
    if whose.projects is not None:
        found.append(table.c.project.in_(whose.projects))
    owner = whose.first if part is Part.OWN else whose.owner
    if owner is not None:
        found.append(table.c.owner == owner)
    if part is Part.OTHERS:
        found.append(table.c.owner.is_distinct_from(whose.first))
    return found


def refusal() -> Rejected:
    """The refusal of a cursor."""
    sentence = "The cursor is not one that this listing gave; leave it out to begin with the first page."
    return Rejected(sentence, [Problem("/cursor", sentence)])


def newest(
    connection: Connection, query: JobQuery, part: Part, before: str | None, limit: int
) -> Sequence[Row[Any]]:
    """The newest jobs that match, of those with ids below `before`; fewer where they are long (`by_bytes`).

    Where projects are the only condition, the newest of each are read by their index. Any other single
    condition has an index in the order of ids, too. Few jobs or none may match several conditions, which the
    planner cannot know: it would walk through all jobs. So the newest jobs are tried first. If too few of
    them match, matches are rare, and all of them are collected from the indexes before they are sorted.
    """
    conditions, whose = _filters(query, jobs), of(jobs, query.whose, part)
    has_owner = part is Part.OWN or query.whose.owner is not None
    if not conditions and query.sweep is None and query.whose.projects and not has_owner:
        return connection.execute(_of_projects(query.whose, part, before, limit)).all()
    if (conditions and len(conditions) + len(whose) > 1) or query.labels or query.search:
        found = connection.execute(_among_the_newest(query, part, before, limit)).all()
        if has_more(found, limit - 1) or not _has_more(connection, before):
            return found
        return connection.execute(_collected(query, part, before, limit)).all()
    found = [*matches(query, jobs, part), *below(jobs, before)]
    wanted = select(jobs.c.id).where(*found).order_by(jobs.c.id.desc()).limit(limit)
    return connection.execute(rows_by_bytes(wanted, size_of(jobs), "id")).all()


def _of_projects(whose: Whose, part: Part, before: str | None, limit: int) -> Any:
    """The newest of each project, of which the newest: PostgreSQL would sort all jobs of several projects."""
    others = of(jobs, whose.model_copy(update={"projects": None}), part)
    each = [
        select(jobs.c.id, size_of(jobs).label("size"))
        .where(jobs.c.project == project, *others, *below(jobs, before))
        .order_by(jobs.c.id.desc())
        .limit(limit)
        for project in whose.projects or ()
    ]
    found = union_all(*each).subquery("of_projects")
    return rows_by_bytes(select(found.c.id).order_by(found.c.id.desc()).limit(limit), found.c.size, "id")


def size_of(table: FromClause) -> ColumnElement[int]:
    """The bytes of the long columns of a job's row."""
    return func.octet_length(table.c.spec) + func.coalesce(func.octet_length(table.c.progress), 0)


def _among_the_newest(query: JobQuery, part: Part, before: str | None, limit: int) -> Any:
    near = select(jobs).where(*below(jobs, before)).order_by(jobs.c.id.desc()).limit(_NEAR).subquery("near")
    wanted = select(near.c.id).where(*matches(query, near, part)).order_by(near.c.id.desc()).limit(limit)
    return rows_by_bytes(wanted, size_of(near), "id")


def _has_more(connection: Connection, before: str | None) -> bool:
    """Whether there are jobs beyond the newest."""
    beyond = select(jobs.c.id).where(*below(jobs, before)).order_by(jobs.c.id.desc()).offset(_NEAR).limit(1)
    return connection.execute(beyond).first() is not None


def _collected(query: JobQuery, part: Part, before: str | None, limit: int) -> Any:
    conditions = [*matches(query, jobs, part), *below(jobs, before)]
    found = select(jobs.c.id).where(*conditions).cte("found").prefix_with("MATERIALIZED")
    wanted = select(jobs.c.id).join(found, jobs.c.id == found.c.id).order_by(jobs.c.id.desc()).limit(limit)
    return rows_by_bytes(wanted, size_of(jobs), "id")


def matches(query: JobQuery, table: FromClause, part: Part) -> list[ColumnElement[bool]]:
    """All conditions of a part of the listing."""
    wanted = [*_filters(query, table), *of(table, query.whose, part)]
    if query.sweep == NO_SWEEP:
        wanted.append(~exists().where(trials.c.job_id == table.c.id))
    if query.sweep == FOLDED and query.sort is None:
        wanted.append(_is_newest_of_its_sweep(query, table))
    return wanted


def _is_newest_of_its_sweep(query: JobQuery, table: FromClause) -> ColumnElement[bool]:
    """Whether it is the newest that matches of its sweep's trials; true for a job that is no trial.

    The jobs of a sweep have one owner and one project. Only for a trial are others looked at, and only newer
    ones: PostgreSQL may read all trials there are to find none.
    """
    mine, others, sibling = trials.alias("mine"), trials.alias("others"), jobs.alias("sibling")
    sweep = select(mine.c.sweep_id).where(mine.c.job_id == table.c.id).limit(1).correlate(table)
    among = [others.c.sweep_id == sweep.scalar_subquery(), others.c.job_id >= table.c.id]
    newest_first = select(others.c.job_id).where(*among).order_by(others.c.job_id.desc()).correlate(table)
    if filters := _filters(query, sibling):
        newest_first = newest_first.where(sibling.c.id == others.c.job_id, *filters)
    is_newest = table.c.id == newest_first.limit(1).scalar_subquery()
    return case((sweep.scalar_subquery().is_(None), true()), else_=is_newest)


def _filters(query: JobQuery, table: FromClause) -> list[ColumnElement[bool]]:
    wanted = [(name, getattr(query, name)) for name in _COLUMNS]
    found: list[ColumnElement[bool]] = [table.c[name] == value for name, value in wanted if value is not None]
    if query.labels:
        found.append(table.c.labels.contains(query.labels))
    if query.search:
        texts = (table.c.name, table.c.note, table.c.environment)
        found.append(or_(*(text.icontains(query.search, autoescape=True) for text in texts)))
    if query.sweep not in (None, NO_SWEEP, FOLDED):
        found.append(table.c.id.in_(select(trials.c.job_id).where(trials.c.sweep_id == query.sweep)))
    return found


def below(table: FromClause, before: str | None) -> list[ColumnElement[bool]]:
    return [] if before is None else [table.c.id < before]


def by_bytes(wanted: Select[*tuple[Any, ...]], size: ColumnElement[int], *order: str) -> Select[Any]:
    """As many of the first rows as have some mebibytes, at least one. order: columns, each descending.

    Each row also says how many there would be: `page_found`.
    """
    found = wanted.add_columns(size.label("page_bytes")).subquery("found")
    downwards = [found.c[name].desc() for name in order]
    up_to = func.sum(found.c.page_bytes).over(order_by=downwards, rows=(None, 0))
    sums = select(found, up_to.label("page_sum"), func.count().over().label("page_found")).subquery("sums")
    within = sums.c.page_sum - sums.c.page_bytes < _MOST_BYTES
    return select(sums).where(within).order_by(*(sums.c[name].desc() for name in order))


def rows_by_bytes(ids: Select[*tuple[Any, ...]], size: ColumnElement[int], *order: str) -> Select[Any]:
    """The rows of jobs, as many as `by_bytes` gives of their ids, with what else `ids` has.

    SQLAlchemy copies each column of each subquery: the windows have only those that they need.
    """
    found = by_bytes(ids, size, *order).subquery("within")
    more = [column for column in found.c if column.name != "id"]
    return (
        select(jobs, *more)
        .join(found, found.c.id == jobs.c.id)
        .order_by(*(found.c[name].desc() for name in order))
    )


def has_more(found: Sequence[Row[Any]], kept: int) -> bool:
    """Whether there were more rows than are kept of these, which `by_bytes` gave."""
    return bool(found) and found[0].page_found > kept
