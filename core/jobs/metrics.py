"""A job's metrics in columns: rows as they were measured, and curves over steps.

They are in columns wherever they lie: the record has a block for each write, the object store one for each
chunk.
"""

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import merge
from itertools import compress, islice, pairwise, repeat
from math import isfinite, isnan, nan
from operator import gt, itemgetter
from typing import Any, NamedTuple, Self, TypeVar

import msgspec

from core.bounds import MOST_METRICS

Names = frozenset[str]
# A tuple that begins with its number.
Row = TypeVar("Row", bound=tuple[Any, ...])


def _integers() -> "array[int]":
    return array("q")


def _floats() -> "array[float]":
    return array("d")


class Measurement(NamedTuple):
    """number: of its entry in the feed. time: seconds since 1970. values: by name; None if not finite."""

    number: int
    step: int
    time: float
    values: Mapping[str, float | None]


@dataclass
class Table:
    """Rows that have the same metrics, in the order of their numbers. columns: by name; nan: not finite."""

    numbers: "array[int]" = field(default_factory=_integers)
    steps: "array[int]" = field(default_factory=_integers)
    times: "array[float]" = field(default_factory=_floats)
    columns: "dict[str, array[float]]" = field(default_factory=dict[str, "array[float]"])

    def lines(self, names: Iterable[str]) -> Iterator[tuple[Any, ...]]:
        """Each row's number, step and time, then the values of these metrics; None for no value."""
        cells = [_cells(self.columns[name]) if name in self.columns else repeat(None) for name in names]
        return zip(self.numbers, self.steps, self.times, *cells, strict=False)  # `repeat` has no end.

    def only(self, wanted: Sequence[bool]) -> "Table":
        """The rows that are wanted. wanted: for each row."""
        if all(wanted):
            return self
        return Table(
            array("q", compress(self.numbers, wanted)),
            array("q", compress(self.steps, wanted)),
            array("d", compress(self.times, wanted)),
            {name: array("d", compress(column, wanted)) for name, column in self.columns.items()},
        )


def _cells(column: "array[float]") -> Iterable[float | None]:
    if not isnan(sum(column)):  # It has no nan.
        return column
    return (None if isnan(value) else value for value in column)


class _Stored(msgspec.Struct, array_like=True):
    """A table as bytes: numbers of 8 bytes, little-endian as every machine that this runs on.

    places: each row's number, less that of the block's first row.
    """

    places: bytes
    steps: bytes
    times: bytes
    columns: dict[str, bytes]


_decoder = msgspec.msgpack.Decoder(list[_Stored])


class Block:
    """Rows of metrics, in a table for each set of names."""

    def __init__(self, tables: dict[Names, Table] | None = None) -> None:
        self.tables = tables or {}

    @classmethod
    def of(cls, rows: Iterable[Measurement]) -> Self:
        """rows: in the order of their numbers."""
        block = cls()
        for row in rows:
            block.add(row)
        return block

    def add(self, row: Measurement) -> None:
        """Append a row, whose number is the greatest."""
        table = self._table(frozenset(row.values), row.values)
        table.numbers.append(row.number)
        table.steps.append(row.step)
        table.times.append(row.time)
        for name, value in row.values.items():
            table.columns[name].append(nan if value is None or not isfinite(value) else value)

    def extend(self, later: "Block") -> None:
        """Append the rows of a block whose numbers are greater."""
        for names, table in later.tables.items():
            own = self._table(names, table.columns)
            own.numbers += table.numbers
            own.steps += table.steps
            own.times += table.times
            for name, column in table.columns.items():
                own.columns[name] += column

    def _table(self, names: Names, in_order: Iterable[str]) -> Table:
        if (table := self.tables.get(names)) is None:
            table = self.tables[names] = Table(columns={name: _floats() for name in in_order})
        return table

    @property
    def first(self) -> int:
        """The number of the first row; 0 without rows."""
        return min((table.numbers[0] for table in self.tables.values() if table.numbers), default=0)

    @property
    def last(self) -> int:
        """The number of the last row; 0 without rows."""
        return max((table.numbers[-1] for table in self.tables.values() if table.numbers), default=0)

    @property
    def names(self) -> list[str]:
        """The names of its metrics, each once."""
        return list(dict.fromkeys(name for table in self.tables.values() for name in table.columns))

    def after(self, number: int) -> "Block":
        """The rows with a greater number."""
        if self.first > number:
            return self
        return self.only(lambda _, table: [one > number for one in table.numbers])

    def only(self, wanted: Callable[[Names, Table], Sequence[bool]]) -> "Block":
        """The rows that are wanted. wanted: for each row of a table."""
        return Block({names: table.only(wanted(names, table)) for names, table in self.tables.items()})

    def lines(self, names: Iterable[str]) -> Iterator[tuple[Any, ...]]:
        """The rows in their order, each as `Table.lines` has it."""
        return _in_order(table.lines(names) for table in self.tables.values())

    def rows(self) -> Iterator[Measurement]:
        """The rows in their order."""
        return _in_order(map(_rows, self.tables.values()))

    def column(self, name: str) -> "tuple[array[int], array[float], array[float]]":
        """A metric's steps, times and values, in the order in which they were measured."""
        tables = [table for table in self.tables.values() if name in table.columns]
        if len(tables) == 1:
            return tables[0].steps, tables[0].times, tables[0].columns[name]
        lines = list(_in_order(table.lines([name]) for table in tables))
        steps, times = array("q", map(itemgetter(1), lines)), array("d", map(itemgetter(2), lines))
        return steps, times, array("d", (nan if value is None else value for *_, value in lines))

    def encode(self) -> bytes:
        """The rows as bytes; the number of the first is kept elsewhere."""
        first = self.first
        return msgspec.msgpack.encode(
            [
                _Stored(
                    array("q", [number - first for number in table.numbers]).tobytes(),
                    table.steps.tobytes(),
                    table.times.tobytes(),
                    {name: column.tobytes() for name, column in table.columns.items()},
                )
                for table in self.tables.values()
            ]
        )

    @classmethod
    def decode(cls, body: bytes, first: int, names: Collection[str] | None = None) -> Self:
        """Read the bytes of `encode`. first: the first row's number. names: only these metrics; None: all."""
        block = cls()
        for stored in _decoder.decode(body):
            columns = {
                name: array("d", column)
                for name, column in stored.columns.items()
                if names is None or name in names
            }
            if columns or names is None:
                numbers = array("q", [first + place for place in array("q", stored.places)])
                block.tables[frozenset(stored.columns)] = Table(
                    numbers, array("q", stored.steps), array("d", stored.times), columns
                )
        return block


def _rows(table: Table) -> Iterator[Measurement]:
    names, cells = list(table.columns), [_cells(column) for column in table.columns.values()]
    values = zip(*cells, strict=True) if cells else repeat(())
    named = (dict(zip(names, row, strict=True)) for row in values)
    return map(Measurement, table.numbers, table.steps, table.times, named)


def _in_order(tables: Iterable[Iterator[Row]]) -> Iterator[Row]:
    found = list(tables)
    return found[0] if len(found) == 1 else merge(*found, key=itemgetter(0))


class Newest:
    """Tells rows that count from those that a later attempt measured again: it has the same step and names.

    names: of all metrics. last: the number of the last row. Of the rows it holds only those that were
    measured again, each with its newest number.
    """

    def __init__(self, blocks: Iterable[Block] = ()) -> None:
        self.names = set[str]()
        self.last = 0
        self._highest_steps: dict[Names, int] = {}
        self._numbers: dict[tuple[int, Names], int] = {}
        for block in blocks:
            self._see(block)

    def _see(self, block: Block) -> None:
        self.last = max(self.last, block.last)
        for names, table in block.tables.items():
            self.names |= names
            highest = self._highest_steps.get(names, -1)
            for number, step in zip(table.numbers, table.steps, strict=True):
                if step <= highest:  # An attempt began again at a checkpoint.
                    self._numbers[step, names] = number
                else:
                    highest = step
            self._highest_steps[names] = highest

    def of(self, block: Block) -> Block:
        """The rows that count, without those that came later than all that were seen."""
        return block.only(
            lambda names, table: [
                self._numbers.get((step, names), number) <= number <= self.last
                for number, step in zip(table.numbers, table.steps, strict=True)
            ]
        )


@dataclass
class Curve:
    """One metric of a job: values over rising steps. times: seconds since 1970; nan: not finite."""

    steps: "array[int]" = field(default_factory=_integers)
    times: "array[float]" = field(default_factory=_floats)
    values: "array[float]" = field(default_factory=_floats)

    def __len__(self) -> int:
        return len(self.steps)

    def extend(self, steps: "array[int]", times: "array[float]", values: "array[float]") -> None:
        """Append what was measured later. A value of an earlier step comes from an attempt that began again
        at a checkpoint: it replaces what followed that checkpoint."""
        for start, end in _rising(steps):
            if self.steps and steps[start] <= self.steps[-1]:
                kept = bisect_left(self.steps, steps[start])
                del self.steps[kept:], self.times[kept:], self.values[kept:]
            self.steps += steps[start:end]
            self.times += times[start:end]
            self.values += values[start:end]

    def between(self, first_step: int | None, last_step: int | None) -> range:
        """The places of the values of these steps, both included."""
        start = 0 if first_step is None else bisect_left(self.steps, first_step)
        end = len(self) if last_step is None else bisect_right(self.steps, last_step)
        return range(start, max(start, end))


def _rising(steps: "array[int]") -> Iterator[tuple[int, int]]:
    """Where the parts with rising steps begin and end."""
    if all(map(gt, islice(steps, 1, None), steps)):  # As those of an attempt are: this is the fast way.
        return iter([(0, len(steps))] if steps else ())
    falls = (place for place, (one, other) in enumerate(pairwise(steps), 1) if other <= one)
    return pairwise([0, *falls, len(steps)])


class Curves(dict[str, Curve]):
    """Metrics by name, `MOST_METRICS` at most."""

    def extend(self, later: Block) -> None:
        """Append what was measured later."""
        for name in later.names:
            if (curve := self.get(name)) is None:
                if len(self) >= MOST_METRICS:
                    continue
                curve = self[name] = Curve()
            curve.extend(*later.column(name))
