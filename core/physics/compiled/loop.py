"""Repetition until nothing improves, for all environments side by side."""

from collections.abc import Callable

import numpy as np

from core.physics.compiled.arithmetic import Number, select
from core.physics.compiled.program import Symbol


def repeat(
    most: int, body: Callable[[list[Number]], tuple[list[Number], Number]], carried: list[Number]
) -> list[Number]:
    """What the numbers are after at most `most` repetitions of `body`, which also says whether to go on.

    True: in any case.

    An environment that need not go on keeps the numbers that it has.
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
