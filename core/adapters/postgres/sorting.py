"""Lists of jobs that are sorted by a column.

All jobs that match are looked at for each page, since a column may change with every report of a job, and an
index on it would make each report slower. So only the newest hundred thousand are, of those that one may see
and whose owner and project are asked for; of a sweep, all trials. A page says that older ones are left out.
"""

import json
import math
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Double,
    Row,
    Text,
    and_,
    collate,
    func,
    literal,
    or_,
    select,
    true,
)
from sqlalchemy import cast as cast_to

from core.adapters.postgres import listing
from core.adapters.postgres.tables import NOW, jobs, trials
from core.errors import JobNotFound
from core.jobs.job import check_job_id
from core.jobs.sorting import Sort
from core.jobs.status import JobStatus
from core.jobs.store import FOLDED, NO_SWEEP, JobQuery

_MOST = 100_000
_PREFIX = "sorted-"


@dataclass(frozen=True)
class _Place:
    """Behind which job a page begins. value: of that job's column. at: of durations, when the first page was
    read, in seconds since 1970: how long a running job has run is the same on all pages.
    """

    sort: Sort
    value: str | float | None
    job: str
    at: float

    def cursor(self) -> str:
        parts = [self.sort.column, self.sort.descending, self.value, self.job, self.at]
        text = json.dumps(parts, ensure_ascii=False, separators=(",", ":"))
        return _PREFIX + urlsafe_b64encode(text.encode()).decode().rstrip("=")


def page(
    connection: Connection, query: JobQuery, sort: Sort, cursor: str | None, limit: int
) -> tuple[Sequence[Row[Any]], str | None, int | None]:
    """A page of at most `limit` rows, the cursor of the next one, and of how many of the newest jobs the list
    is; None where it leaves out none. Raises Rejected for a wrong cursor.

    A job whose value changes between two pages may be missed, or come twice.
    """
    place = None if cursor is None else _place(cursor, sort)
    at = _now(connection, sort) if place is None else place.at
    left_out = _newest_left_out(connection, query)
    of_newest = None if left_out is None else _MOST
    found = connection.execute(_sorted(query, sort, at, place, limit + 1, left_out)).all()
    rows = found[:limit]
    if not listing.has_more(found, len(rows)):
        return rows, None, of_newest
    return rows, _Place(sort, rows[-1].sorted_by, rows[-1].id, at).cursor(), of_newest


def _now(connection: Connection, sort: Sort) -> float:
    """Only durations need it: each statement is a round trip."""
    return connection.execute(select(_epoch(NOW))).scalar_one() if sort.column == "duration" else 0.0


def _place(cursor: str, sort: Sort) -> _Place:
    """Raises Rejected."""
    text = cursor.removeprefix(_PREFIX)
    try:
        column, descending, value, job, at = json.loads(urlsafe_b64decode(text + "=" * (-len(text) % 4)))
        found = _Place(Sort(column=column, descending=descending), value, check_job_id(job), float(at))
        # Its text has to be one that PostgreSQL takes.
        is_text = isinstance(value, str) and b"\0" not in value.encode()
        is_number = isinstance(value, float) and math.isfinite(value)
        is_value = value is None or (is_text if _is_text(sort) else is_number)
    except (ValueError, TypeError, OverflowError, JobNotFound):
        raise listing.refusal() from None
    if text == cursor or found.sort != sort or not is_value or not math.isfinite(found.at):
        raise listing.refusal()
    return found


def _is_text(sort: Sort) -> bool:
    return isinstance(_key(sort, 0.0).type, Text)


def _key(sort: Sort, at: float) -> ColumnElement[Any]:
    """The column as text or a number; null for a job that has none. at: until when running jobs have run."""
    if sort.label is not None:
        return _text(jobs.c.labels[sort.label].astext)
    match sort.column:
        case "created" | "started" | "finished":
            return _epoch(jobs.c[f"{sort.column}_at"])
        case "name":
            return _text(func.lower(jobs.c.name))
        case "status":
            place = func.array_position(literal([status.value for status in JobStatus]), jobs.c.status)
            return cast_to(place, Double)
        case "duration":
            return func.coalesce(_epoch(jobs.c.finished_at), literal(at, Double)) - _epoch(jobs.c.started_at)
        case "steps" | "steps_per_second" | "return":
            names = {"steps": "step", "steps_per_second": "speed", "return": "return"}
            return jobs.c[f"progress_{names[sort.column]}"]
        case "attempts":
            return cast_to(jobs.c.num_attempts, Double)
        case _:
            return _text(jobs.c[sort.column])


def _text(value: ColumnElement[Any]) -> ColumnElement[Any]:
    """In the order of its bytes, which is the same in a database of any language, and fast."""
    return collate(cast_to(value, Text), "C")


def _epoch(moment: ColumnElement[Any]) -> ColumnElement[Any]:
    # `extract` gives an exact number, which takes longer.
    return func.date_part("epoch", moment, type_=Double)


def _newest_left_out(connection: Connection, query: JobQuery) -> str | None:
    """Of those that one may see, the newest job that is not looked at; None if all are."""
    if query.sweep not in (None, NO_SWEEP, FOLDED):
        return None
    seen = select(jobs.c.id).where(*listing.of(jobs, query.whose, listing.Part.ALL))
    return connection.execute(seen.order_by(jobs.c.id.desc()).offset(_MOST).limit(1)).scalar()


def _sorted(
    query: JobQuery, sort: Sort, at: float, place: _Place | None, limit: int, left_out: str | None
) -> Any:
    matches = listing.matches(query, jobs, listing.Part.ALL)
    if left_out is not None:
        matches.append(jobs.c.id > left_out)
    key = _key(sort, at)
    among = select(jobs.c.id, key.label("sorted_by")).where(*matches)
    if query.sweep == FOLDED:
        among = among.outerjoin(trials, trials.c.job_id == jobs.c.id)
        among = among.add_columns(func.coalesce(trials.c.sweep_id, jobs.c.id).label("whole"))
    keyed = among.subquery("keyed")
    is_shown = true()
    if query.sweep == FOLDED:
        # Of each sweep the first in this order.
        order = _order(keyed.c.sorted_by, keyed.c.id, sort)
        place_in_sweep = func.row_number().over(partition_by=keyed.c.whole, order_by=order)
        keyed = select(keyed, place_in_sweep.label("of_sweep")).subquery("folded")
        is_shown = keyed.c.of_sweep == 1
    behind = true() if place is None else _behind(keyed.c.sorted_by, keyed.c.id, place)
    top = select(keyed.c.id, keyed.c.sorted_by).where(is_shown, behind)
    top = top.order_by(*_order(keyed.c.sorted_by, keyed.c.id, sort)).limit(limit).subquery("top")
    place_in_page = func.row_number().over(order_by=_order(top.c.sorted_by, top.c.id, sort))
    ids = select(top.c.id, top.c.sorted_by, (-place_in_page).label("below")).join(jobs, top.c.id == jobs.c.id)
    return listing.rows_by_bytes(ids, listing.size_of(jobs), "below")


def _order(key: ColumnElement[Any], job: ColumnElement[Any], sort: Sort) -> tuple[ColumnElement[Any], ...]:
    """Of equal ones the newest first, either way."""
    way = key.desc() if sort.descending else key.asc()
    return way.nulls_last(), job.desc()


def _behind(key: ColumnElement[Any], job: ColumnElement[Any], place: _Place) -> ColumnElement[bool]:
    older = job < place.job
    if place.value is None:
        return and_(key.is_(None), older)
    beyond = key < place.value if place.sort.descending else key > place.value
    return or_(beyond, and_(key == place.value, older), key.is_(None))
