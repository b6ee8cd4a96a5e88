"""A job's metrics as a table: without the rows that a later attempt measured again, and as CSV."""

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from core.jobs.store import Entry
from gaitway.schema import MetricsRow

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
# A row's step, and the names that were measured.
Identity = tuple[int, frozenset[str]]


@dataclass
class Overview:
    """Facts on all rows, which the first line of a table needs.

    names: of all columns besides step and time. last: the last entry's number. Of the rows it holds only
    those that were measured again, each with its newest entry's number.
    """

    names: set[str] = field(default_factory=set[str])
    last: int = 0
    _highest_steps: dict[frozenset[str], int] = field(default_factory=dict[frozenset[str], int])
    _newest: dict[Identity, int] = field(default_factory=dict[Identity, int])

    @classmethod
    def of(cls, entries: Iterable[Entry]) -> "Overview":
        overview = cls()
        for entry in entries:
            overview._add(entry)
        return overview

    def _add(self, entry: Entry) -> None:
        step, names = identity = _identity(entry)
        highest = self._highest_steps.get(names)
        self.last = int(entry.id)
        if highest is not None and step <= highest:  # A later attempt began again at a checkpoint.
            self._newest[identity] = self.last
        else:
            self._highest_steps[names] = step
        self.names |= names

    def newest(self, entries: Iterable[Entry]) -> list[MetricsRow]:
        """The rows of these entries, without those that were measured again or came later."""
        return [MetricsRow(**entry.data, time=entry.time) for entry in entries if self._is_newest(entry)]

    def _is_newest(self, entry: Entry) -> bool:
        number = int(entry.id)
        return self._newest.get(_identity(entry), number) <= number <= self.last


def csv_lines(pages: Iterable[Sequence[Entry]], overview: Overview) -> Iterator[str]:
    """CSV (RFC 4180), page by page: step, time, then every name in alphabetical order; empty for no value."""
    names = sorted(overview.names)
    yield _csv([["step", "time", *map(_harmless, names)]])
    for page in pages:
        yield _csv(
            [row.step, row.time.isoformat(), *(row.values.get(name) for name in names)]
            for row in overview.newest(page)
        )


def _identity(entry: Entry) -> Identity:
    return entry.data["step"], frozenset(entry.data["values"])


def _harmless(text: str) -> str:
    """A cell that no spreadsheet takes for a formula, as the page's CSV has it."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def _csv(rows: Iterable[Iterable[object]]) -> str:
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()
