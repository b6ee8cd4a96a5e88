"""A function as a list of plain operations on numbers, for programs that have no JAX.

`core.environments.tracing` makes one of a JAX function; the page's JavaScript evaluates it (docs/push.md);
an exporter may write it as a graph. Every number of an input, every constant and every result has a cell.
Slices, reshapes and constant indices only move numbers, and are done while a function is traced, so that
operations know no shapes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cells = NDArray[np.int64]


class NotExpressed(Exception):
    """The function needs an operation that is none of `OPERATIONS`. The sentence says which."""


def _select(condition: Any, otherwise: Any, chosen: Any) -> Any:
    return np.where(condition != 0, chosen, otherwise)


# By name: the result of one number of each argument. Truth is 1, falsehood 0.
OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "abs": np.abs,
    "acos": np.arccos,
    "add": np.add,
    "and": np.logical_and,
    "asin": np.arcsin,
    "atan2": np.arctan2,
    "ceil": np.ceil,
    "cos": np.cos,
    "div": np.divide,
    "eq": np.equal,
    "exp": np.exp,
    "floor": np.floor,
    "ge": np.greater_equal,
    "gt": np.greater,
    "is_finite": np.isfinite,
    "le": np.less_equal,
    "log": np.log,
    "lt": np.less,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "ne": np.not_equal,
    "neg": np.negative,
    "or": np.logical_or,
    "pow": np.power,
    "rem": np.fmod,
    # The argument is a condition; then the results where it is false, and where it is true.
    "select": _select,
    "sign": np.sign,
    "sin": np.sin,
    "sqrt": np.sqrt,
    "sub": np.subtract,
    "tan": np.tan,
    "tanh": np.tanh,
    "trunc": np.trunc,
}
# By name: one number from each `size` consecutive ones of the argument.
REDUCTIONS: Mapping[str, Callable[..., Any]] = {
    "reduce_max": np.max,
    "reduce_min": np.min,
    "reduce_prod": np.prod,
    "reduce_sum": np.sum,
}


@dataclass(frozen=True)
class Operation:
    """name: of `OPERATIONS` or `REDUCTIONS`. results: its cells [n], consecutive. arguments: the cells of
    each, [n], or [n size] of a reduction."""

    name: str
    results: Cells
    arguments: tuple[Cells, ...]

    @property
    def size(self) -> int:
        """How many numbers of the argument make one of the result."""
        return len(self.arguments[0]) // max(1, len(self.results))


@dataclass(frozen=True)
class Output:
    """cells: of an array of this shape, flattened in C order."""

    cells: Cells
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Expression:
    """Inputs ↦ outputs, each by name.

    inputs: the places in each flattened input of the numbers that are used. Cells are those of the inputs in
    this order, then of the constants, then of the results. missing: by output, what keeps it from being one.
    """

    inputs: Mapping[str, Cells]
    constants: NDArray[np.float64]
    operations: Sequence[Operation]
    outputs: Mapping[str, Output]
    missing: Mapping[str, str]

    def __call__(self, inputs: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
        """The outputs, in double precision. inputs: arrays by name; others are ignored."""
        used = [np.ravel(inputs[name])[places] for name, places in self.inputs.items()]
        known = np.concatenate([*used, self.constants]).astype(float)
        cells = np.concatenate([known, np.empty(sum(len(one.results) for one in self.operations))])
        for one in self.operations:
            arguments = [cells[argument] for argument in one.arguments]
            if one.name in REDUCTIONS:
                cells[one.results] = REDUCTIONS[one.name](arguments[0].reshape(-1, one.size), axis=1)
            else:
                cells[one.results] = OPERATIONS[one.name](*arguments)
        return {name: cells[output.cells].reshape(output.shape) for name, output in self.outputs.items()}

    def only(self, names: Iterable[str]) -> "Expression":
        """The expression of these outputs, without what they do not need. Raises NotExpressed."""
        names = list(names)
        if why := next((self.missing[name] for name in names if name in self.missing), None):
            raise NotExpressed(why)
        return _needed(self, {name: self.outputs[name] for name in names})

    def document(self) -> dict[str, Any]:
        """As JSON; numbers that are not finite are written as text."""
        return {
            "inputs": [[name, places.tolist()] for name, places in self.inputs.items()],
            "constants": [value if isfinite(value) else str(value) for value in self.constants.tolist()],
            "operations": [
                [one.name, len(one.results), *(argument.tolist() for argument in one.arguments)]
                for one in self.operations
            ],
            "outputs": {name: output.cells.tolist() for name, output in self.outputs.items()},
        }


def _needed(whole: Expression, outputs: Mapping[str, Output]) -> Expression:
    """The expression of these outputs with the cells alone on which they depend."""
    sizes = [len(places) for places in whole.inputs.values()]
    first_constant = sum(sizes)
    first_result = first_constant + len(whole.constants)
    is_used = np.zeros(first_result + sum(len(one.results) for one in whole.operations), bool)
    for output in outputs.values():
        is_used[output.cells] = True
    kept: list[Operation] = []
    for one in reversed(whole.operations):
        rows = is_used[one.results]
        if rows.any():
            arguments = tuple(cells.reshape(len(rows), -1)[rows].ravel() for cells in one.arguments)
            is_used[np.concatenate(arguments)] = True
            kept.append(Operation(one.name, one.results[rows], arguments))
    number = np.cumsum(is_used) - 1
    starts = np.cumsum([0, *sizes])
    inputs = {
        name: places[is_used[start : start + len(places)]]
        for (name, places), start in zip(whole.inputs.items(), starts, strict=False)
    }
    return Expression(
        {name: places for name, places in inputs.items() if len(places)},
        whole.constants[is_used[first_constant:first_result]],
        [
            Operation(one.name, number[one.results], tuple(number[cells] for cells in one.arguments))
            for one in reversed(kept)
        ],
        {name: Output(number[output.cells], output.shape) for name, output in outputs.items()},
        {},
    )
