"""Which of a state's arrays later steps read: only these have to be carried from step to step."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.interpreters.partial_eval import dce_jaxpr


def carried(step: Callable[..., tuple[Any, Any]], state: Sequence[Any], *others: Any) -> list[bool]:
    """For each array of the state, whether the next step or a later one needs it.

    step: (state, *others) -> (state afterwards, results); both states have the same number of arrays. state,
    others: arrays, or their shapes. An array that only feeds itself is not needed. Found in the traced
    program by dead code elimination; a loop without a fixed length counts as reading all of its inputs.
    """
    jaxpr = jax.make_jaxpr(step)(state, *others).jaxpr
    num_results = len(jaxpr.outvars) - len(state)
    needed = [False] * len(state)
    while True:
        _, read = dce_jaxpr(jaxpr, [*needed, *[True] * num_results])
        # The step before must have left what a step reads.
        grown = [one or other for one, other in zip(needed, read[: len(state)], strict=True)]
        if grown == needed:
            return needed
        needed = grown
