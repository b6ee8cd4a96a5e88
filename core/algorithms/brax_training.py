"""The parts of Brax's training code that we use, loaded without Brax's physics.

`import brax` loads its environments, which load MJX, which loads Warp and trimesh: half of a job's import
time, for nothing that training needs. The package's own names are loaded when one is first used.
The running statistics of observations, which centre and scale what a network sees, are Brax's, too.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from core.environments.environment import ObservationSize
from core.start_up import put_off

put_off("brax")

from brax.training import distribution, networks  # noqa: E402
from brax.training.acme import running_statistics, specs  # noqa: E402
from brax.training.acme.running_statistics import RunningStatisticsState  # noqa: E402
from brax.training.agents.ppo.losses import PPONetworkParams  # noqa: E402
from brax.training.agents.ppo.networks import (  # noqa: E402
    PPONetworks,
    make_inference_fn,
    make_ppo_networks,
)
from brax.training.types import Transition, UInt64, identity_observation_preprocessor  # noqa: E402

__all__ = [
    "PPONetworkParams",
    "PPONetworks",
    "RunningStatisticsState",
    "Transition",
    "UInt64",
    "distribution",
    "identity_observation_preprocessor",
    "make_inference_fn",
    "make_ppo_networks",
    "networks",
    "running_statistics",
    "specs",
]


def init_normalizer(observation_size: ObservationSize) -> RunningStatisticsState:
    """Mean 0 and deviation 1: the identity, until it is updated."""
    sizes = dict(observation_size) if isinstance(observation_size, Mapping) else observation_size
    shapes: Any = jax.tree.map(lambda size: specs.Array((size,), jnp.dtype("float32")), sizes)
    state = running_statistics.init_state(shapes)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, getattr(leaf, "dtype", jnp.float32)), state)


def normalization(max_abs_value: float | None) -> Callable[[Any, RunningStatisticsState], Any]:
    """(observations, normaliser) -> deviations from the mean, clipped to ± `max_abs_value` if it is set."""
    return partial(running_statistics.normalize, max_abs_value=max_abs_value)
