"""A job's metrics as rows and as CSV."""

import csv
import io
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime

import msgspec

from core.jobs.metrics import Block, Newest
from gaitway.schema import MetricsRow

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


def csv_lines(blocks: Iterable[Block], newest: Newest) -> Iterator[str]:
    """The rows that count as CSV (RFC 4180), a block at a time: step, time, then every name in alphabetical
    order; empty for no value."""
    names = sorted(newest.names)
    yield _csv([["step", "time", *map(_harmless, names)]])
    for block in blocks:
        lines = newest.of(block).lines(names)
        yield _csv([step, _moment(time).isoformat(), *values] for _, step, time, *values in lines)


def _moment(time: float) -> datetime:
    return datetime.fromtimestamp(time, UTC)


def _harmless(text: str) -> str:
    """A cell that no spreadsheet takes for a formula, as the page's CSV has it."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def _csv(rows: Iterable[Iterable[object]]) -> str:
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()
