"""Memory that a program computes places in: arrays, tables of the model, lists, and loops over them.

The code of a loop over a table is written once, however many rows the table has. A place is the same for all
environments that are computed together: the lanes of a vector on a CPU, and on a GPU a thread's one. Where
one of them needs a row of a list, all of them compute it: what is computed for the others must change
nothing, as a contact without stiffness does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.program.arithmetic import Number, Vector, clip, total
from mujoco_compiled.program.program import (
    Bound,
    Each,
    OwnSpace,
    Place,
    Program,
    Read,
    Space,
    Store,
    Symbol,
    Together,
)

Index = Place | int


@dataclass(frozen=True)
class Array:
    """Rows of numbers of an environment, `width` each."""

    program: Program
    first: int
    width: int
    space: OwnSpace = "numbers"

    def read(self, row: Index, places: Sequence[int]) -> Vector:
        """The numbers at these places of a row."""
        return [_number(self.program, self.space, self._at(row) + place) for place in places]

    def __len__(self) -> int:
        """How many numbers a row has."""
        return self.width

    def row(self, row: Index) -> Vector:
        return self.read(row, range(len(self)))

    def part(self, first: Place, width: int) -> "Array":
        """Of each row, the numbers from place `first` on, as a row of its own; not to be read beyond it."""
        return _Part(self.program, self.first, self.width, self.space, first, width)

    def store(self, row: Index, values: Sequence[Number], first: int = 0) -> None:
        """Puts the values to a row, from place `first` on."""
        for place, value in enumerate(values, first):
            variable = self.program.variable(value)
            self.program.statements.append(Store(self.space, self._at(row) + place, variable))

    def add(self, row: Index, values: Sequence[Number], first: int = 0) -> None:
        """Adds the values to those of a row."""
        places = range(first, first + len(values))
        before = self.read(row, places)
        self.store(row, [x + y for x, y in zip(before, values, strict=True)], first)

    def flat(self) -> "Array":
        """The same numbers, one to a row."""
        return replace(self, width=1)

    def _at(self, row: Index) -> Place:
        return _placed(row) * self.width + self.first


@dataclass(frozen=True)
class _Part(Array):
    """begin: of a row's part, which the running program chooses."""

    begin: Place = field(default_factory=Place)
    own_width: int = 0

    def __len__(self) -> int:
        return self.own_width

    def _at(self, row: Index) -> Place:
        return super()._at(row) + self.begin


@dataclass(frozen=True)
class Column:
    """A number for each row of a table. values: one for all rows, an environment's own in an array, or where
    the model's begin among the constants."""

    program: Program
    values: Number | Array | int

    def at(self, row: Index) -> Number:
        match self.values:
            case Array():
                return self.values.row(row)[0]
            case int():
                return _number(self.program, "constants", _placed(row) + self.values)
            case _:
                return self.values

    def looked_up(self, index: Number, most: int) -> Number:
        """The number in the row that is the whole part of an index, each environment's own, from 0 to `most`;
        that of the nearest row beyond these."""
        assert not isinstance(self.values, Array)  # noqa: S101
        if not isinstance(self.values, int):
            return self.values
        bounded = self.program.variable(clip(index, 0.0, float(most)))
        read = Read(0, "constants", Place(self.values), index=bounded)
        return Symbol(self.program, _read(self.program, read))


@dataclass(frozen=True, eq=False)
class Lookup:
    """The model's numbers, by row, of which each environment reads a row of its own. name: of one table."""

    name: str
    values: NDArray[np.float64]

    def at(self, row: Number) -> Number:
        """The number in a row; see `Column.looked_up`."""
        most = len(self.values) - 1
        if not isinstance(row, Symbol):
            return self.values[np.fmin(np.fmax(row, 0.0), most).astype(int)]
        memory = row.program.memory
        if self.name not in memory.arrays:
            memory.arrays[self.name] = len(memory.constants)
            memory.constants += self.values.tolist()
        return Column(row.program, memory.arrays[self.name]).looked_up(row, most)


@dataclass(frozen=True)
class Integers:
    """An integer for each row of a table."""

    program: Program
    values: Sequence[int]
    first: int

    def at(self, row: Index) -> Place:
        if len(set(self.values)) <= 1:
            return Place(self.values[0] if self.values else 0)
        return _integer(self.program, "integers", _placed(row) + self.first)


@dataclass(frozen=True)
class Rows:
    """A list of integers, at most `most`, which the running program makes.

    What is appended to a full one goes to a row past its end, and is lost: `overflow` tells so from then on.
    """

    program: Program
    first: int
    most: int

    def clear(self) -> None:
        """Empties it, unless it overflowed."""
        self._store_length(self._length(("beyond", self.most)))

    def restart(self) -> Place:
        """Empties it, and returns how long it was: a body may go through it and append what it keeps.

        The length lies beside the list, as a program in sections reads an integer where it is used.
        """
        kept = Place(self.first + 2 + self.most)
        self.program.statements.append(Store("counts", kept, self.length()))
        self.clear()
        return _integer(self.program, "counts", kept)

    def append(self, value: Index) -> Place:
        """Returns the value's row in the list."""
        row = self.length()
        self.program.statements.append(Store("counts", row + (self.first + 1), _placed(value)))
        self._store_length(self._length() + 1)
        return row

    def length(self) -> Place:
        return self._length(("most", self.most))

    def overflow(self) -> Number:
        """0 unless more was ever appended than it holds."""
        return _number(self.program, "counts", Place(self.first), bound=("beyond", self.most))

    def _length(self, bound: Bound | None = None) -> Place:
        return _integer(self.program, "counts", Place(self.first), bound=bound)

    def _store_length(self, length: Place) -> None:
        self.program.statements.append(Store("counts", Place(self.first), length))

    def at(self, row: Index) -> Place:
        return _integer(self.program, "counts", _placed(row) + (self.first + 1))


def array(program: Program, name: str, rows: int, width: int = 1, space: OwnSpace = "numbers") -> Array:
    """The array of this name; the first call makes it."""
    memory = program.memory
    if name not in memory.arrays:
        memory.arrays[name] = memory.sizes[space]
        memory.sizes[space] += rows * width
        if space == "common":
            memory.commons.append(memory.arrays[name])
    return Array(program, memory.arrays[name], width, space)


def rows(program: Program, name: str, most: int) -> Rows:
    """The list of this name; the first call makes it."""
    memory = program.memory
    if name not in memory.arrays:
        memory.arrays[name] = memory.num_counts
        memory.num_counts += 3 + most
        memory.lists[name] = most
        with program.before_loops():
            program.statements.append(Store("counts", Place(memory.arrays[name]), Place(0)))
    return Rows(program, memory.arrays[name], most)


def overflow(program: Program) -> Number:
    """More than 0 if any list lost something."""
    lists = program.memory.lists.items()
    return total(Rows(program, program.memory.arrays[name], most).overflow() for name, most in lists)


def column(program: Program, name: str, values: Sequence[Number]) -> Column:
    """values: by row. The first call makes it; an environment's own numbers go to the array of this name."""
    memory = program.memory
    if any(isinstance(value, Symbol) for value in values):
        is_new = name not in memory.arrays
        own = array(program, name, len(values))
        with program.before_loops():
            for row, value in enumerate(values if is_new else ()):
                own.store(row, [value])
        return Column(program, own)
    if len(set(values)) == 1:
        return Column(program, float(values[0]))
    # Two tables of one name may have different numbers: those of two kinds of sensors, for example.
    table = f"{name}: {values}"
    if table not in memory.arrays:
        memory.arrays[table] = len(memory.constants)
        memory.constants += [float(value) for value in values]
    return Column(program, memory.arrays[table])


def integers(program: Program, name: str, values: Sequence[int]) -> Integers:
    """values: by row. The first call of this name makes it."""
    memory = program.memory
    if name not in memory.arrays:
        memory.arrays[name] = len(memory.integers)
        memory.tables.append(len(memory.integers))
        memory.integers += values
    return Integers(program, values, memory.arrays[name])


def for_each(
    program: Program,
    count: Index,
    body: Callable[[Place, Vector], Vector],
    carried: Sequence[Number] = (),
    *,
    is_parted: bool = False,
    meets: bool = True,
) -> Vector:
    """The carried numbers after `body` for each integer from 0 to `count` - 1. The body may store.

    is_parted, meets: in a routine; see `Each`. Nothing is carried then.
    """
    counter = program.new_variable()
    inside = [Symbol(program, program.new_variable()) for _ in carried]
    with program.block() as statements:
        afters = [program.variable(value) for value in body(Place(0, ((counter, 1),)), list(inside))]
    befores = [program.variable(value) for value in carried]
    entries = tuple(zip((one.number for one in inside), befores, afters, strict=True))
    program.statements.append(
        Each(_placed(count), counter, entries, tuple(statements), is_parted, is_parted and meets)
    )
    return list(inside)


class Table:
    """Rows of integers, in groups. groups: their rows, all of one length."""

    def __init__(self, program: Program, name: str, groups: Sequence[Sequence[tuple[int, ...]]]) -> None:
        rows = [row for own in groups for row in own]
        self._program, self._width = program, len(rows[0]) if rows else 0
        self._numbers = integers(program, name, [number for row in rows for number in row])
        self._lengths = integers(program, f"{name}: lengths", list(map(len, groups)))
        begins = [sum(map(len, groups[:number])) for number in range(len(groups))]
        self._begins = integers(program, f"{name}: begins", begins)

    def at(self, row: Place) -> list[Place]:
        return [self._numbers.at(row * self._width + place) for place in range(self._width)]

    def for_each(
        self,
        group: Index,
        body: Callable[[Place, Vector], Vector],
        carried: Sequence[Number] = (),
        *,
        is_parted: bool = False,
        meets: bool = True,
    ) -> Vector:
        """`for_each`, over the rows of a group."""
        begin, count = self._begins.at(group), self._lengths.at(group)
        return for_each(
            self._program,
            count,
            lambda number, now: body(begin + number, now),
            carried,
            is_parted=is_parted,
            meets=meets,
        )


def where_any(condition: Symbol, body: Callable[[], object]) -> None:
    """Does the body, which stores, for all environments that are computed together if one needs it."""
    program = condition.program
    with program.block() as statements:
        body()
    program.statements.append(Together(condition.number, tuple(statements)))


def _placed(index: Index) -> Place:
    return Place(index) if isinstance(index, int) else index


def _number(program: Program, space: Space, place: Place, bound: Bound | None = None) -> Symbol:
    return Symbol(program, _read(program, Read(0, space, place, bound, is_number=space == "counts")))


def _integer(program: Program, space: Space, place: Place, bound: Bound | None = None) -> Place:
    return Place(0, ((_read(program, Read(0, space, place, bound)), 1),))


def _read(program: Program, read: Read) -> int:
    """What the model has is read once; where a program stores, something else may lie the next time."""
    if read.space in ("constants", "integers"):
        return program.known(("read", read), lambda target: replace(read, target=target))
    target = program.new_variable()
    program.statements.append(replace(read, target=target))
    return target
