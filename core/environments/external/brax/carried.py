"""Which of a state's arrays the next step reads: all that has to be carried from step to step."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.interpreters.partial_eval import dce_jaxpr


def carried(step: Callable[..., tuple[Any, Any]], state: Sequence[Any], *others: Any) -> list[bool]:
    """Of each array of the state, whether a step needs it, or a later one does.

    step: (state, *others) -> (state afterwards, results), with as many arrays in the one state as in the
    other. state, others: arrays, or their shapes. An array that only feeds itself is not needed. Found in
    the traced program, as a compiler finds dead code; loops without a fixed length count as reading all
    that goes into them.
    """
    jaxpr = jax.make_jaxpr(step)(state, *others).jaxpr
    num_results = len(jaxpr.outvars) - len(state)
    needed = [False] * len(state)
    while True:
        _, read = dce_jaxpr(jaxpr, [*needed, *[True] * num_results])
        # What a step reads, the step before must have left.
        grown = [one or other for one, other in zip(needed, read[: len(state)], strict=True)]
        if grown == needed:
            return needed
        needed = grown
