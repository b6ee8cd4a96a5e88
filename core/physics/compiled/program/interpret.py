"""Runs a program with NumPy, one operation after another: slow, and the measure of all code that is made."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.physics.compiled.program.program import Assign, Loop, Operation, Program, Statement

Values = dict[int, NDArray[Any]]

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
    program: Program, given: Mapping[str, Sequence[NDArray[np.floating]]]
) -> dict[str, list[NDArray[np.floating]]]:
    """The outputs. given: by input, an array [environments] for each of its numbers.

    Where the lanes of a folded program differ, a number is an array [lanes, environments] inside.
    """
    dtype = next(iter(given.values()))[0].dtype
    values = Values()
    _run(program.statements, values, given, dtype)
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
    given: Mapping[str, Sequence[NDArray[np.floating]]],
    dtype: np.dtype[np.floating],
) -> None:
    for statement in statements:
        match statement:
            case Assign(target=target, operation="input", arguments=(str(name), int(place))):
                values[target] = given[name][place]
            case Assign(target=target, operation="constant", arguments=(value,)):
                values[target] = np.asarray(value, dtype)
            case Assign(target=target, operation="limb_constant", arguments=(int(lane), *of_lanes)):
                values[target] = np.asarray(of_lanes[lane], dtype)
            case Assign(target=target, operation="lane_constant", arguments=of_lanes):
                values[target] = np.asarray(of_lanes, dtype)[:, None]
            case Assign(target=target, operation="lane_input", arguments=(str(name), *places)):
                values[target] = np.stack([given[name][int(place)] for place in places])
            case Assign(target=target, operation="lane_sum", arguments=(number,)):
                values[target] = np.sum(values[int(number)], axis=0)
            case Assign(target=target, operation=operation, arguments=arguments):
                values[target] = _FUNCTIONS[operation](*(values[int(number)] for number in arguments))
            case Loop():
                _repeat(statement, values, given, dtype)


def _repeat(
    loop: Loop,
    values: Values,
    given: Mapping[str, Sequence[NDArray[np.floating]]],
    dtype: np.dtype[np.floating],
) -> None:
    """An environment that need not go on keeps the numbers that it has."""
    for variable, before, _ in loop.carried:
        values[variable] = values[before]
    running: NDArray[Any] = np.asarray(True)
    for _ in range(loop.most):
        if not running.any():
            break
        _run(loop.body, values, given, dtype)
        after = [np.where(running, values[after], values[variable]) for variable, _, after in loop.carried]
        if loop.improves is not None:
            running = running & values[loop.improves]
        for (variable, _, _), value in zip(loop.carried, after, strict=True):
            values[variable] = value
