"""Loops and branches that environments take side by side, each for itself."""

from collections.abc import Callable

import numpy as np

from core.physics.compiled.program.arithmetic import Number, Vector, select
from core.physics.compiled.program.program import Symbol


def repeat(
    most: int, body: Callable[[list[Number]], tuple[list[Number], Number]], carried: list[Number]
) -> list[Number]:
    """The numbers after at most `most` repetitions of `body`.

    `body` also returns whether to repeat it, by environment; True: in any case. An environment that stops
    keeps the numbers that it has.
    """
    symbol = next((number for number in carried if isinstance(number, Symbol)), None)
    if symbol is not None:
        return symbol.program.loop(most, body, carried)
    running = np.True_
    for _ in range(most):
        if not np.any(running):
            break
        after, improves = body(carried)
        carried = [select(running, new, old) for new, old in zip(after, carried, strict=True)]
        running = running & improves
    return carried


def where_needed(
    condition: Number, body: Callable[[], Vector], otherwise: Callable[[Vector], Vector]
) -> Vector:
    """The body's numbers where the condition is true. It costs nothing while it is true nowhere.

    otherwise: from the body's numbers, of which it may use constants alone, to those elsewhere.
    """
    if isinstance(condition, Symbol):
        return condition.program.branch(condition, body, otherwise)
    if isinstance(condition, bool | np.bool_):
        return body() if condition else otherwise(body())
    values = body()
    return [select(condition, one, other) for one, other in zip(values, otherwise(values), strict=True)]


def nothing(values: Vector) -> Vector:
    """A 0 for each of them."""
    return [0.0] * len(values)
