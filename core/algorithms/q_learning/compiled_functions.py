"""The compiled programs of a run: traced and compiled once, before the first step."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.evaluation import EpisodeTotals
from core.algorithms.q_learning.learner import Failure, Hyperparameters, Learner, TrainingState


@dataclass(frozen=True)
class CompiledFunctions:
    """Functions that can only run, never compile again: other shapes are an error.

    init: the state before the first round, from the agents' keys. epoch: see Learner.epoch; it consumes the
    state it is given. evaluate: see Learner.evaluate.
    """

    init: Callable[[jax.Array], TrainingState]
    epoch: Callable[[TrainingState, Hyperparameters, np.int32], tuple[TrainingState, Any, Failure]]
    evaluate: Callable[[jax.Array, jax.Array, jax.Array], EpisodeTotals]


def trace(
    learner: Learner, hyperparameters: Hyperparameters, keys: jax.Array
) -> Callable[[], CompiledFunctions]:
    """Trace every program; calling the result compiles them, side by side."""
    count = jax.ShapeDtypeStruct((), jnp.int32)
    state = jax.eval_shape(learner.init, keys)
    lowered = (
        jax.jit(learner.init).lower(keys),
        jax.jit(learner.epoch, donate_argnums=0).lower(state, hyperparameters, count),
        jax.jit(learner.evaluate).lower(state.table, state.eval_key, count),
    )

    def compile_all() -> CompiledFunctions:
        with ThreadPoolExecutor() as pool:
            return CompiledFunctions(*pool.map(lambda program: program.compile(), lowered))

    return compile_all
