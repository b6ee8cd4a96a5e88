"""The interface of an environment, as algorithms use it; its finite views; and the base of wrappers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import mujoco
from flax import struct

from core.physics.engine import NOMINAL, ModelFields, PhysicsState

# Arrays by the names that a state discretizer needs: entries of `State.info`, and `observation`.
Seen = Mapping[str, jax.Array]


@dataclass(frozen=True)
class StateDiscretizer:
    """find_rows: from what is seen of one environment to [num_parts] int32 row numbers, each below
    num_states.

    num_parts: parts of the body that read for themselves, such as arms; 1: the whole body does.
    names: the rows', for people; empty where their numbers say as much.
    """

    needs: tuple[str, ...]
    num_states: int
    num_parts: int
    find_rows: Callable[[Seen], jax.Array]
    names: tuple[str, ...] = ()

    def __call__(self, seen: Seen) -> jax.Array:
        """The rows [num_parts] int32; -1 where what is needed is not finite."""
        finite = [jnp.all(jnp.isfinite(seen[name])) for name in self.needs]
        return jnp.where(jnp.all(jnp.stack(finite)), self.find_rows(seen), -1)


@dataclass(frozen=True)
class ActionSet:
    """act: from choices [num_parts] int32, each below num_choices, to an action [action_size].

    num_parts: parts of the body that choose for themselves, such as arms; 1: the whole body does.
    names: the choices', for people; empty where their numbers say as much.
    """

    num_choices: int
    num_parts: int
    act: Callable[[jax.Array], jax.Array]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Discretization:
    """The finite views that an environment itself offers, by the names that jobs use."""

    state_discretizers: Mapping[str, StateDiscretizer] = field(default_factory=dict[str, StateDiscretizer])
    action_sets: Mapping[str, ActionSet] = field(default_factory=dict[str, ActionSet])


CONTINUOUS = Discretization()


# An entry of `State.info`, [] float32, of tasks that can be over: 1 where `done` is no failure.
TRUNCATED = "truncated"

# One array [size], or arrays by name: `state` is what a policy sees unless a run says otherwise.
Observation = Any
ObservationSize = int | Mapping[str, int]


@struct.dataclass
class State:
    """One environment after a step; a leading batch axis appears under `jax.vmap`.

    obs: [observation_size], or arrays by name. reward, done: [] float32; `done` is 1 where the environment
    ended the episode: it *terminated* unless `info` says that it was `TRUNCATED`. A wrapper handles
    truncation by length. metrics: named scalars, the same names at every step. info: arrays that a wrapper or
    the environment carries from step to step.
    """

    physics: PhysicsState
    obs: Observation
    reward: jax.Array
    done: jax.Array
    metrics: Mapping[str, jax.Array]
    info: Mapping[str, jax.Array]


def terminated(state: State) -> jax.Array:
    """1 where the environment ended the episode by a failure, otherwise 0; [...]."""
    return state.done * (1 - state.info[TRUNCATED]) if TRUNCATED in state.info else state.done


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


@dataclass(frozen=True)
class Wrapped:
    """Model, times, sizes and finite views are those of the environment inside."""

    environment: Environment

    @property
    def model(self) -> mujoco.MjModel:
        return self.environment.model

    @property
    def dt(self) -> float:
        return self.environment.dt

    @property
    def episode_length(self) -> int:
        return self.environment.episode_length

    @property
    def observation_size(self) -> ObservationSize:
        return self.environment.observation_size

    @property
    def action_size(self) -> int:
        return self.environment.action_size

    @property
    def tracked_body(self) -> int:
        return self.environment.tracked_body

    @property
    def discretization(self) -> Discretization:
        return self.environment.discretization


def innermost(environment: Environment) -> Environment:
    """The environment inside all wrappers."""
    while isinstance(environment, Wrapped):
        environment = environment.environment
    return environment


def with_innermost(environment: Environment, change: Callable[[Environment], Environment]) -> Environment:
    """The same wrappers around the changed environment inside them."""
    if isinstance(environment, Wrapped):
        return replace(environment, environment=with_innermost(environment.environment, change))
    return change(environment)
