"""The interface of an environment, as algorithms use it."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import jax
import mujoco
from flax import struct

from core.environments.discretization import Discretization
from core.physics.engine import NOMINAL, ModelFields, PhysicsState

# One array [size], or arrays by name: `state` is what a policy sees unless a run says otherwise.
Observation = Any
ObservationSize = int | Mapping[str, int]


@struct.dataclass
class State:
    """One environment after a step; a leading batch axis appears under `jax.vmap`.

    obs: [observation_size], or arrays by name. reward, done: [] float32; `done` is 1 where the episode
    *terminated*: a wrapper handles truncation by length. metrics: named scalars, the same names
    at every step. info: arrays that a wrapper or the environment carries from step to step.
    """

    physics: PhysicsState
    obs: Observation
    reward: jax.Array
    done: jax.Array
    metrics: Mapping[str, jax.Array]
    info: Mapping[str, jax.Array]


@runtime_checkable  # for the tests, which check annotations
class Environment(Protocol):
    """Pure functions over one environment. It was built with an engine, but does not know which."""

    @property
    def model(self) -> mujoco.MjModel:
        """The model that is stepped; also what a renderer draws."""
        ...

    @property
    def observation_size(self) -> ObservationSize:
        """The size of the one observation, or of each by name."""
        ...

    @property
    def action_size(self) -> int: ...

    @property
    def dt(self) -> float:
        """Seconds between two actions."""
        ...

    @property
    def episode_length(self) -> int:
        """Actions after which an episode is cut off."""
        ...

    @property
    def tracked_body(self) -> int:
        """Id of the body whose motion is measured and which the default camera follows."""
        ...

    @property
    def discretization(self) -> Discretization:
        """The finite views that it offers; CONTINUOUS if it offers none."""
        ...

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        """A fresh initial state. model: fields that replace the model's own; see PhysicsState."""
        ...

    def step(self, state: State, action: jax.Array) -> State:
        """The state after one action [action_size], each component in [-1, 1]."""
        ...
