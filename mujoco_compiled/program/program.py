"""A program of scalar operations, written down by the stages when they compute with symbols.

A symbol stands for a number that is known only when the program runs. Operations on symbols append to the
program's open block; equal operations are written once, and those with 0 and 1 not at all.

A program may run in several lanes, each with a limb of the body and all of its trunk (`fold`). Then
`lane_input` (name, place by lane) and `lane_constant` (value by lane) differ between lanes, and `lane_sum` is
a number's sum over the lanes, which has the same bits in each. Before it is folded, the program of a whole
body has `limb_constant` (lane, value by lane): the value of that lane, which must not melt into others.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, cast

Operation = Literal[
    "input", "constant", "limb_constant", "lane_input", "lane_constant", "lane_sum",
    "add", "subtract", "multiply", "divide", "negate",
    "sqrt", "sin", "cos", "absolute", "truncate", "minimum", "maximum",
    "less", "and", "not", "select",
]  # fmt: skip


# Their arguments are no variables.
_GIVEN = ("input", "constant", "limb_constant", "lane_input", "lane_constant")


@dataclass(frozen=True)
class Assign:
    """Variable `target` is the operation's result. arguments: numbers of variables, or a constant's value, or
    an input's name and place."""

    target: int
    operation: Operation
    arguments: tuple[int | float | str, ...]

    @property
    def uses(self) -> Sequence[int]:
        """The variables that it needs."""
        return () if self.operation in _GIVEN else cast("tuple[int, ...]", self.arguments)


@dataclass(frozen=True)
class Loop:
    """Repeats `body` at most `most` times, as long as `improves` is true after it; None: always.

    carried: variables with the values before the first repetition and after each: (variable, before, after).
    """

    most: int
    carried: tuple[tuple[int, int, int], ...]
    body: tuple["Statement", ...]
    improves: int | None


@dataclass(frozen=True)
class Branch:
    """Computes `body` for environments in which the variable `condition` is true.

    results: (variable, its value from the body, its value otherwise).
    """

    condition: int
    body: tuple["Statement", ...]
    results: tuple[tuple[int, int, int], ...]


# Where numbers lie: `constants` and `integers` are the model's, the others can be written. An environment has
# its own `numbers`, and its own `shared` and `common`, which routines see: the first is small and nearer. An
# integer of `counts` is one for all environments that are computed together.
OwnSpace = Literal["numbers", "shared", "common"]
Space = OwnSpace | Literal["counts", "constants", "integers"]
# What a read makes of an integer of `counts`: the lesser of it and a bound, or 0 unless it is beyond that.
Bound = tuple[Literal["most", "beyond"], int]


@dataclass(frozen=True)
class Place:
    """An integer: `offset`, and the sum of strides times variables that hold integers, (variable, stride)."""

    offset: int = 0
    terms: tuple[tuple[int, int], ...] = ()

    def __add__(self, other: "Place | int") -> "Place":
        if isinstance(other, int):
            return Place(self.offset + other, self.terms)
        return Place(self.offset + other.offset, self.terms + other.terms)

    def __mul__(self, factor: int) -> "Place":
        return Place(self.offset * factor, tuple((one, stride * factor) for one, stride in self.terms))

    @property
    def variables(self) -> list[int]:
        return [one for one, _ in self.terms]


@dataclass(frozen=True)
class Read:
    """Variable `target` is what lies at a place. is_number: whether an integer becomes a number.

    index: a variable whose whole part each environment adds to the place, for itself; of `constants` alone.
    """

    target: int
    space: Space
    place: Place
    bound: Bound | None = None
    is_number: bool = False
    index: int | None = None

    @property
    def uses(self) -> list[int]:
        """The variables that it needs."""
        return [*self.place.variables, *([] if self.index is None else [self.index])]

    @property
    def is_integer(self) -> bool:
        """Whether the variable is one of places, not of numbers."""
        return self.space in ("counts", "integers") and not self.is_number


@dataclass(frozen=True)
class Store:
    """Puts a variable to a place in `numbers`, `shared` or `common`, or an integer to one in `counts`."""

    space: Space
    place: Place
    value: "int | Place"

    @property
    def uses(self) -> list[int]:
        """The variables that it needs."""
        value = [self.value] if isinstance(self.value, int) else self.value.variables
        return [*self.place.variables, *value]


@dataclass(frozen=True)
class Each:
    """Computes `body` for each value of the integer variable `counter` from 0 to `count` - 1.

    carried: see Loop. All environments that are computed together go through it as often. is_parted: no
    repetition needs what another one does, so that the threads of a routine share them. meets: whether they
    wait for each other after it.
    """

    count: Place
    counter: int
    carried: tuple[tuple[int, int, int], ...]
    body: tuple["Statement", ...]
    is_parted: bool = False
    meets: bool = False


@dataclass(frozen=True)
class Together:
    """Computes `body` for all environments that are computed together if `condition` is true in one."""

    condition: int
    body: tuple["Statement", ...]


@dataclass(frozen=True)
class Call:
    """Computes a routine of the program, which works on `shared`, `common` and the model's numbers alone.

    A GPU has several threads of an environment for it.
    """

    routine: str

    @property
    def uses(self) -> Sequence[int]:
        """The variables that it needs: none."""
        return ()


Statement = Assign | Loop | Branch | Read | Store | Each | Together | Call


@dataclass(frozen=True)
class Output:
    """A variable that is written out. places: by lane, or one place if all lanes have the same number."""

    variable: int
    places: tuple[int, ...]


@dataclass
class Memory:
    """sizes: how many numbers an environment has, by space. num_counts: how much of `counts` there is.
    arrays: where arrays, lists and columns begin, by name. lists: how long lists may get. constants,
    integers: what lies there. tables, commons: where those of `integers` and the arrays of `common` begin."""

    sizes: dict[OwnSpace, int] = field(default_factory=lambda: {"numbers": 0, "shared": 0, "common": 0})
    num_counts: int = 0
    arrays: dict[str, int] = field(default_factory=dict[str, int])
    lists: dict[str, int] = field(default_factory=dict[str, int])
    constants: list[float] = field(default_factory=list[float])
    integers: list[int] = field(default_factory=list[int])
    tables: list[int] = field(default_factory=list[int])
    commons: list[int] = field(default_factory=list[int])


@dataclass
class Program:
    """statements: of the open block. outputs: by name, in the order of their places. routines: by name.
    has_team: whether several threads may compute a routine."""

    statements: list[Statement] = field(default_factory=list[Statement])
    outputs: dict[str, list[Output]] = field(default_factory=dict[str, list[Output]])
    num_lanes: int = 1
    has_team: bool = False
    memory: "Memory" = field(default_factory=lambda: Memory())
    routines: dict[str, tuple[Statement, ...]] = field(default_factory=dict[str, tuple[Statement, ...]])
    _known: dict[tuple[object, ...], int] = field(default_factory=dict[tuple[object, ...], int])
    _order: list[tuple[object, ...]] = field(default_factory=list[tuple[object, ...]])  # of what is known
    _open: list[list[Statement]] = field(default_factory=list[list[Statement]])  # blocks around the open one
    _num_variables: int = 0

    def inputs(self, name: str, size: int) -> list["Symbol"]:
        """The numbers of an input, such as qpos [nq]."""
        return [self.write("input", name, place) for place in range(size)]

    def output(self, name: str, values: Sequence["Symbol | float"]) -> None:
        self.outputs[name] = [Output(self.variable(value), (place,)) for place, value in enumerate(values)]

    def write(self, operation: Operation, *arguments: int | float | str) -> "Symbol":
        """The symbol of an operation, which is written down unless it is there already."""
        key = (operation, *arguments)
        if key not in self._known:
            self._known[key] = self.new_variable()
            self._order.append(key)
            self.statements.append(Assign(self._known[key], operation, arguments))
        return Symbol(self, self._known[key])

    def known(self, key: tuple[object, ...], make: Callable[[int], Statement]) -> int:
        """The variable under a key, which a statement computes unless it is there already."""
        if key not in self._known:
            self._known[key] = self.new_variable()
            self._order.append(key)
            self.statements.append(make(self._known[key]))
        return self._known[key]

    def variable(self, value: "Symbol | float") -> int:
        """The variable that holds the value."""
        if not isinstance(value, Symbol):
            return self.write("constant", float(value)).number
        return self.write("negate", value.number).number if value.negative else value.number

    def loop(
        self,
        most: int,
        body: Callable[[list["Symbol | float"]], tuple[Sequence["Symbol | float"], "Symbol | bool"]],
        carried: Sequence["Symbol | float"],
    ) -> list["Symbol | float"]:
        """The carried numbers after the repetitions; see Loop. Constants that stay are not carried."""
        changes = [isinstance(value, Symbol) for value in carried]
        while True:
            inside = [
                Symbol(self, self.new_variable()) if one else value
                for value, one in zip(carried, changes, strict=True)
            ]
            with self.block() as statements:
                values, go_on = body(inside)
                found = [
                    one or isinstance(after, Symbol) or after != value
                    for value, after, one in zip(carried, values, changes, strict=True)
                ]
                afters = [self.variable(value) for value, one in zip(values, found, strict=True) if one]
                improves = self.variable(go_on) if isinstance(go_on, Symbol) else None
            if found == changes:
                break
            changes = found  # The body was written as if some of them were constants.
        variables = [one.number for one in inside if isinstance(one, Symbol)]
        befores = [self.variable(value) for value, one in zip(carried, changes, strict=True) if one]
        entries = tuple(zip(variables, befores, afters, strict=True))
        self.statements.append(Loop(most, entries, tuple(statements), improves))
        return inside

    def branch(
        self,
        condition: "Symbol",
        body: Callable[[], Sequence["Symbol | float"]],
        otherwise: Callable[[list["Symbol | float"]], Sequence["Symbol | float"]],
    ) -> list["Symbol | float"]:
        """The body's numbers where the condition is true; see Branch. Those that do not differ stay.

        otherwise: from the body's numbers, of which it may use constants alone, to those elsewhere.
        """
        with self.block() as statements:
            values = list(body())
            others = otherwise(values)
            differ = [not _are_same(*both) for both in zip(values, others, strict=True)]
            insides = [self.variable(value) for value, one in zip(values, differ, strict=True) if one]
        outsides = [self.variable(value) for value, one in zip(others, differ, strict=True) if one]
        chosen = [Symbol(self, self.new_variable()) for _ in insides]
        results = zip((one.number for one in chosen), insides, outsides, strict=True)
        if chosen:
            self.statements.append(Branch(condition.number, tuple(statements), tuple(results)))
        following = iter(chosen)
        return [next(following) if one else value for value, one in zip(others, differ, strict=True)]

    def routine(self, name: str, body: Callable[[], object]) -> None:
        """Calls the routine of this name; the first call writes it, with no variable from outside.

        Raises ValueError if it reads or writes what other threads of an environment do not see.
        """
        if name not in self.routines:
            known, order = self._known, self._order
            self._known, self._order = {}, []
            with self.block() as statements:
                body()
            self._known, self._order = known, order
            if not _is_seen(statements):
                raise ValueError(f"The routine {name!r} works on numbers of one thread.")
            self.routines[name] = tuple(statements)
        self.statements.append(Call(name))

    @contextmanager
    def block(self) -> Generator[list[Statement]]:
        """A block of its own: what is computed in it is not known after it."""
        num_known = len(self._order)
        self._open.append(self.statements)
        self.statements = []
        yield self.statements
        self.statements = self._open.pop()
        for key in self._order[num_known:]:
            del self._known[key]
        del self._order[num_known:]

    @contextmanager
    def before_loops(self) -> Generator[None]:
        """What is written there comes before all loops and branches that are open."""
        inner, known, order = self.statements, self._known, self._order
        self.statements = self._open[0] if self._open else inner
        # What is known here may be computed later than there.
        self._known, self._order = {}, []
        yield
        self.statements, self._known, self._order = inner, known, order

    def new_variable(self) -> int:
        self._num_variables += 1
        return self._num_variables - 1


@dataclass(frozen=True, eq=False)
class Symbol:
    """A program's variable, or its negative: a sign costs no operation."""

    program: Program
    number: int
    negative: bool = False

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Symbol) and (self.number, self.negative) == (other.number, other.negative)

    def __hash__(self) -> int:
        return hash((self.number, self.negative))

    def __bool__(self) -> bool:
        raise TypeError("A symbol is neither true nor false while the program is written.")

    def __neg__(self) -> "Symbol":
        return Symbol(self.program, self.number, not self.negative)

    def __add__(self, other: "Symbol | float") -> "Symbol | float":
        if not isinstance(other, Symbol):
            if other == 0.0:
                return self
            constant = self.program.write("constant", float(abs(other)))
            other = constant if other > 0.0 else -constant
        if self.number == other.number:
            return 2.0 * self if self.negative == other.negative else 0.0
        first, second = sorted((self, other), key=lambda symbol: symbol.number)
        if first.negative == second.negative:
            whole = self.program.write("add", first.number, second.number)
        else:
            whole = self.program.write("subtract", first.number, second.number)
        return -whole if first.negative else whole

    __radd__ = __add__

    def __sub__(self, other: "Symbol | float") -> "Symbol | float":
        return self + -other

    def __rsub__(self, other: "Symbol | float") -> "Symbol | float":
        return -self + other

    def __mul__(self, other: "Symbol | float") -> "Symbol | float":
        if not isinstance(other, Symbol):
            if other in (0.0, 1.0, -1.0):
                return (0.0, self, -self)[int(other)]
            constant = self.program.write("constant", float(abs(other)))
            other = constant if other > 0.0 else -constant
        first, second = sorted((self.number, other.number))
        whole = self.program.write("multiply", first, second)
        return -whole if self.negative != other.negative else whole

    __rmul__ = __mul__

    def __truediv__(self, other: "Symbol | float") -> "Symbol | float":
        if not isinstance(other, Symbol):
            return self * (1.0 / other)
        whole = self.program.write("divide", self.number, other.number)
        return -whole if self.negative != other.negative else whole

    def __rtruediv__(self, other: float) -> "Symbol | float":
        if other == 0.0:
            return 0.0
        return Symbol(self.program, self.program.variable(other)) / self

    def __pow__(self, power: int) -> "Symbol | float":
        value: Symbol | float = 1.0
        for _ in range(power):
            value = self * value
        return value

    def __lt__(self, other: "Symbol | float") -> "Symbol":
        return self.program.write("less", self.program.variable(self), self.program.variable(other))

    def __gt__(self, other: "Symbol | float") -> "Symbol":
        return self.program.write("less", self.program.variable(other), self.program.variable(self))

    def __and__(self, other: "Symbol") -> "Symbol":
        return self.program.write("and", *sorted((self.number, other.number)))

    def __invert__(self) -> "Symbol":
        return self.program.write("not", self.number)


def _is_seen(statements: Sequence[Statement]) -> bool:
    """Whether they work on what routines see alone."""
    for one in statements:
        match one:
            case Assign():
                is_seen = one.operation not in ("input", "lane_input")
            case Read() | Store():
                is_seen = one.space not in ("numbers", "counts")
            case Each():
                is_seen = _is_seen(one.body)
            case _:
                is_seen = False
        if not is_seen:
            return False
    return True


def assigns(statements: Sequence[Statement]) -> Iterator[Assign]:
    """All operations, those in loops and branches, too."""
    for one in statements:
        if isinstance(one, Assign):
            yield one
        elif not isinstance(one, Read | Store | Call):
            yield from assigns(one.body)


def call(operation: Operation, *arguments: "Symbol | float") -> "Symbol | float":
    """A function of numbers of which at least one is a symbol."""
    if operation == "select" and _are_same(*arguments[1:]):
        return arguments[1]
    program = next(argument.program for argument in arguments if isinstance(argument, Symbol))
    return program.write(operation, *(program.variable(argument) for argument in arguments))


def _are_same(one: "Symbol | float", other: "Symbol | float") -> bool:
    return isinstance(one, Symbol) == isinstance(other, Symbol) and one == other
