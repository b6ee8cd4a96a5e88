"""Pages of listings end at a number of rows, or at a number of bytes: rows may be long."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, func, select

_MOST_BYTES = 2**22


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
