"""Runs a program with NumPy, one operation after another: slow, and the measure of all code that is made."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mujoco_compiled.program.program import Assign, Branch, Loop, Operation, Program, Statement

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
    values = Values()
    _run(program.statements, values, inputs, dtype)
    found = dict[str, list[NDArray[np.floating]]]()
    for name, outputs in program.outputs.items():
        by_place = dict[int, NDArray[np.floating]]()
        for output in outputs:
            for lane, place in enumerate(output.places):
                value = values[output.variable]
                by_place[place] = value[lane] if value.ndim > 1 else value
        found[name] = [by_place[place] for place in range(len(by_place))]
    return found


def _run(
    statements: Sequence[Statement],
    values: Values,
    inputs: Mapping[str, Sequence[NDArray[np.floating]]],
    dtype: np.dtype[np.floating],
) -> None:
    for statement in statements:
        # Nearly all statements: looking for all else first would take most of the time.
        if isinstance(statement, Assign):
            if function := _FUNCTIONS.get(statement.operation):
                values[statement.target] = function(*[values[number] for number in statement.arguments])
            else:
                values[statement.target] = _given(statement, values, inputs, dtype)
        elif isinstance(statement, Loop):
            _repeat(statement, values, inputs, dtype)
        else:
            _choose(statement, values, inputs, dtype)


def _given(
    one: Assign,
    values: Values,
    inputs: Mapping[str, Sequence[NDArray[np.floating]]],
    dtype: np.dtype[np.floating],
) -> NDArray[Any]:
    """A number that is given, or the sum of one over the lanes."""
    match one:
        case Assign(operation="input", arguments=(str(name), int(place))):
            return inputs[name][place]
        case Assign(operation="constant", arguments=(value,)):
            return np.asarray(value, dtype)
        case Assign(operation="limb_constant", arguments=(int(lane), *of_lanes)):
            return np.asarray(of_lanes[lane], dtype)
        case Assign(operation="lane_constant", arguments=of_lanes):
            return np.asarray(of_lanes, dtype)[:, None]
        case Assign(operation="lane_input", arguments=(str(name), *places)):
            return np.stack([inputs[name][int(place)] for place in places])
        case Assign(operation="lane_sum", arguments=(number,)):
            return np.sum(values[int(number)], axis=0)
        case _:
            raise AssertionError(one)


def _repeat(
    loop: Loop,
    values: Values,
    inputs: Mapping[str, Sequence[NDArray[np.floating]]],
    dtype: np.dtype[np.floating],
) -> None:
    """An environment that need not go on keeps the numbers that it has."""
    for variable, before, _ in loop.carried:
        values[variable] = values[before]
    running: NDArray[Any] = np.asarray(True)
    for _ in range(loop.most):
        if not running.any():
            break
        _run(loop.body, values, inputs, dtype)
        after = [np.where(running, values[after], values[variable]) for variable, _, after in loop.carried]
        if loop.improves is not None:
            running = running & values[loop.improves]
        for (variable, _, _), value in zip(loop.carried, after, strict=True):
            values[variable] = value


def _choose(
    branch: Branch,
    values: Values,
    inputs: Mapping[str, Sequence[NDArray[np.floating]]],
    dtype: np.dtype[np.floating],
) -> None:
    condition = values[branch.condition]
    if condition.any():
        _run(branch.body, values, inputs, dtype)
    for variable, inside, otherwise in branch.results:
        chosen = values[inside] if condition.any() else values[otherwise]
        values[variable] = np.where(condition, chosen, values[otherwise])
