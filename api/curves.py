"""Metrics as readers ask for them: points of curves, and a table of rows as CSV."""

import csv
import io
from collections.abc import Collection, Iterable, Iterator, Sequence
from datetime import UTC, datetime
from math import isnan

import msgspec

from core.jobs.metrics import Block, Curves, Newest
from gaitway.schema import MetricsRow

# In one answer, which is written at once: 5,900 rows of ten metrics.
MOST_VALUES = 100_000


def extremes(values: Sequence[float], places: range, points: int) -> list[int]:
    """At most `points` (4 or more) of these places, in order: the first, the last, and of each of equally
    long parts between them the places of the least and the greatest value.

    A line through them covers the same pixels as one through all values, if the picture has at most half of
    `points` columns. Values that are nan count only where a part has no others.
    """
    if len(places) <= points:
        return list(places)
    inner, num_parts = places[1:-1], (points - 2) // 2
    kept = [places[0]]
    for part in range(num_parts):
        within = inner[part * len(inner) // num_parts : (part + 1) * len(inner) // num_parts]
        first = next((place for place in within if not isnan(values[place])), None)
        if first is None:
            kept.append(within.start)
        else:  # No nan is less or greater than another value, so `min` and `max` pass over those that follow.
            numbers = values[first : within.stop]
            kept += sorted({first + numbers.index(value) for value in (min(numbers), max(numbers))})
    return [*kept, places[-1]]


def thinned(
    curves: Curves,
    points: int,
    names: Collection[str] | None = None,
    first_step: int | None = None,
    last_step: int | None = None,
) -> list[MetricsRow]:
    """Rows with at most `points` values of each metric, and `MOST_VALUES` of all, in the order of their steps
    and times.

    names: only these metrics; None: all.
    """
    rows: dict[tuple[int, float], dict[str, float | None]] = {}
    wanted = {name: curve for name, curve in curves.items() if names is None or name in names}
    points = max(4, min(points, MOST_VALUES // max(1, len(wanted))))
    for name, curve in wanted.items():
        for place in extremes(curve.values, curve.between(first_step, last_step), points):
            row = rows.setdefault((curve.steps[place], curve.times[place]), {})
            row[name] = curve.values[place]
    return [
        MetricsRow(step=step, time=datetime.fromtimestamp(time, UTC), values=values)
        for (step, time), values in sorted(rows.items(), key=lambda row: row[0])
    ]


_encoder = msgspec.json.Encoder()
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def metrics_rows(block: Block) -> list[MetricsRow]:
    return [
        MetricsRow(step=step, time=_moment(time), values=dict(values))
        for _, step, time, values in block.rows()
    ]


def json_lines(blocks: Iterable[Block]) -> Iterator[bytes]:
    """The rows as JSON by the line, a block at a time."""
    for block in blocks:
        yield _encoder.encode_lines(
            {"step": step, "time": _moment(time), "values": values} for _, step, time, values in block.rows()
        )


def csv_lines(blocks: Iterable[Block], newest: Newest) -> Iterator[bytes]:
    """The rows that count as CSV (RFC 4180), a block at a time: step, time, then every name in alphabetical
    order; empty for no value."""
    names = sorted(newest.names)
    head = io.StringIO()
    csv.writer(head).writerow(["step", "time", *map(_harmless, names)])
    yield head.getvalue().encode()
    for block in blocks:
        lines = newest.of(block).lines(names)
        if rows := [(step, _moment(time), *values) for _, step, time, *values in lines]:
            yield _csv(rows)


def _csv(rows: Sequence[tuple[int | datetime | float | None, ...]]) -> bytes:
    """Lists of lists in JSON are CSV but for brackets, `null`, and the times' quotes and zone.

    The module `csv` takes four times as long for numbers.
    """
    text = _encoder.encode(rows).removeprefix(b"[[").removesuffix(b"]]") + b"\r\n"
    for json, cell in ((b"],[", b"\r\n"), (b"null", b""), (b'Z"', b"+00:00"), (b'"', b"")):
        text = text.replace(json, cell)
    return text


def _moment(time: float) -> datetime:
    return datetime.fromtimestamp(time, UTC)


def _harmless(text: str) -> str:
    """A cell that no spreadsheet takes for a formula, as the page's CSV has it."""
    return f"'{text}" if text.startswith(_FORMULA) else text
