"""Running statistics of observations (Brax's), which centre and scale what a network sees."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from core.algorithms.brax_training import RunningStatisticsState, running_statistics, specs
from core.environments.environment import ObservationSize


def init_normalizer(observation_size: ObservationSize) -> RunningStatisticsState:
    """Mean 0 and deviation 1: the identity, until it is updated."""
    sizes = dict(observation_size) if isinstance(observation_size, Mapping) else observation_size
    shapes: Any = jax.tree.map(lambda size: specs.Array((size,), jnp.dtype("float32")), sizes)
    state = running_statistics.init_state(shapes)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, getattr(leaf, "dtype", jnp.float32)), state)


def normalization(max_abs_value: float | None) -> Callable[[Any, RunningStatisticsState], Any]:
    """(observations, normaliser) -> deviations from the mean, clipped to ± `max_abs_value` if it is set."""
    return partial(running_statistics.normalize, max_abs_value=max_abs_value)
