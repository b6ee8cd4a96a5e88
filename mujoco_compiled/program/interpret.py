"""Runs a program with NumPy, one operation after another: slow, and the measure of all code that is made."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.program.program import (
    Assign,
    Bound,
    Branch,
    Call,
    Each,
    Loop,
    Operation,
    Place,
    Program,
    Read,
    Space,
    Statement,
    Store,
    Together,
)

# By variable: a number, among other arguments of an operation.
Values = dict[int | float | str, NDArray[Any]]

_FUNCTIONS: Mapping[Operation, Callable[..., NDArray[Any]]] = {
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "negate": np.negative,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "absolute": np.abs,
    "truncate": np.trunc,
    "minimum": np.minimum,
    "maximum": np.maximum,
    "less": np.less,
    "and": np.logical_and,
    "not": np.logical_not,
    "select": np.where,
}


def interpret(
    program: Program, inputs: Mapping[str, Sequence[NDArray[np.floating]]]
) -> dict[str, list[NDArray[np.floating]]]:
    """The outputs. inputs: by input, an array [environments] for each of its numbers.

    Where the lanes of a folded program differ, a number is an array [lanes, environments] inside.
    """
    dtype = next(iter(inputs.values()))[0].dtype
    values = _Interpreter(inputs, dtype, program).run(program.statements)
    found = dict[str, list[NDArray[np.floating]]]()
    for name, outputs in program.outputs.items():
        by_place = dict[int, NDArray[np.floating]]()
        for output in outputs:
            for lane, place in enumerate(output.places):
                value = values[output.variable]
                by_place[place] = value[lane] if value.ndim > 1 else value
        found[name] = [by_place[place] for place in range(len(by_place))]
    return found


@dataclass
class _Interpreter:
    """numbers: what lies in `numbers`, `shared` and `common`, by space and place. counts: by place.
    integers: by variable."""

    inputs: Mapping[str, Sequence[NDArray[np.floating]]]
    dtype: np.dtype[np.floating]
    program: Program
    values: Values = field(default_factory=Values)
    integers: dict[int, int] = field(default_factory=dict[int, int])
    numbers: dict[tuple[Space, int], NDArray[Any]] = field(
        default_factory=dict[tuple[Space, int], NDArray[Any]]
    )
    counts: dict[int, int] = field(default_factory=dict[int, int])

    def run(self, statements: Sequence[Statement]) -> Values:
        values = self.values
        for statement in statements:
            # Nearly all statements: looking for all else first would take most of the time.
            if isinstance(statement, Assign):
                if function := _FUNCTIONS.get(statement.operation):
                    values[statement.target] = function(*[values[number] for number in statement.arguments])
                else:
                    values[statement.target] = self._given(statement)
            else:
                self._other(statement)
        return values

    def _other(self, statement: Statement) -> None:
        match statement:
            case Loop():
                self._repeat(statement)
            case Branch():
                self._choose(statement)
            case Read():
                self._read(statement)
            case Store():
                self._store(statement)
            case Each():
                self._each(statement)
            case Together():
                if np.any(self.values[statement.condition]):
                    self.run(statement.body)
            case Call():
                self.run(self.program.routines[statement.routine])
            case Assign():
                raise AssertionError(statement)

    def _given(self, one: Assign) -> NDArray[Any]:
        """A number that is given, or the sum of one over the lanes."""
        match one:
            case Assign(operation="input", arguments=(str(name), int(place))):
                return self.inputs[name][place]
            case Assign(operation="constant", arguments=(value,)):
                return np.asarray(value, self.dtype)
            case Assign(operation="limb_constant", arguments=(int(lane), *of_lanes)):
                return np.asarray(of_lanes[lane], self.dtype)
            case Assign(operation="lane_constant", arguments=of_lanes):
                return np.asarray(of_lanes, self.dtype)[:, None]
            case Assign(operation="lane_input", arguments=(str(name), *places)):
                return np.stack([self.inputs[name][int(place)] for place in places])
            case Assign(operation="lane_sum", arguments=(number,)):
                return np.sum(self.values[int(number)], axis=0)
            case _:
                raise AssertionError(one)

    def _repeat(self, loop: Loop) -> None:
        """An environment that need not go on keeps the numbers that it has."""
        values = self.values
        for variable, before, _ in loop.carried:
            values[variable] = values[before]
        running: NDArray[Any] = np.asarray(True)
        for _ in range(loop.most):
            if not running.any():
                break
            self.run(loop.body)
            after = [
                np.where(running, values[after], values[variable]) for variable, _, after in loop.carried
            ]
            if loop.improves is not None:
                running = running & values[loop.improves]
            for (variable, _, _), value in zip(loop.carried, after, strict=True):
                values[variable] = value

    def _choose(self, branch: Branch) -> None:
        values = self.values
        condition = values[branch.condition]
        if condition.any():
            self.run(branch.body)
        for variable, inside, otherwise in branch.results:
            chosen = values[inside] if condition.any() else values[otherwise]
            values[variable] = np.where(condition, chosen, values[otherwise])

    def _each(self, each: Each) -> None:
        values = self.values
        for variable, before, _ in each.carried:
            values[variable] = values[before]
        for number in range(self._integer(each.count)):
            self.integers[each.counter] = number
            self.run(each.body)
            after = [values[after] for _, _, after in each.carried]
            values.update(zip((variable for variable, _, _ in each.carried), after, strict=True))

    def _read(self, read: Read) -> None:
        place = self._integer(read.place)
        match read.space:
            case "numbers" | "shared" | "common":
                self.values[read.target] = self.numbers[read.space, place]
            case "constants":
                self.values[read.target] = self._constant(place, read.index)
            case "counts":
                number = self._bounded(self.counts[place], read.bound)
                if read.is_number:
                    self.values[read.target] = np.asarray(number, self.dtype)
                else:
                    self.integers[read.target] = number
            case "integers":
                self.integers[read.target] = self.program.memory.integers[place]

    def _constant(self, place: int, index: int | None) -> NDArray[Any]:
        if index is None:
            return np.asarray(self.program.memory.constants[place], self.dtype)
        return self._constants[place + self.values[index].astype(int)]

    @cached_property
    def _constants(self) -> NDArray[Any]:
        return np.asarray(self.program.memory.constants, self.dtype)

    def _store(self, store: Store) -> None:
        place = self._integer(store.place)
        if isinstance(store.value, int):
            self.numbers[store.space, place] = self.values[store.value]
        else:
            self.counts[place] = self._integer(store.value)

    def _bounded(self, number: int, bound: Bound | None) -> int:
        match bound:
            case ("most", most):
                return min(number, most)
            case ("beyond", most):
                return number if number > most else 0
            case _:
                return number

    def _integer(self, place: Place) -> int:
        return place.offset + sum(stride * self.integers[one] for one, stride in place.terms)
