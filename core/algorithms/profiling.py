"""Where the time of an update goes: parts of it, compiled and timed alone."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from core.algorithms.algorithm import Algorithm
from core.algorithms.compiled_functions import compiler_options
from core.environments.environment import Environment, State
from core.environments.wrappers.action_repeat import repeat_action
from core.environments.wrappers.vectorized import VectorEnv

_LEAST_S, _LEAST_CALLS = 1.0, 3


class UpdateTimes(NamedTuple):
    """Seconds in an update. experience: all acting; physics: of these, the environments' steps."""

    experience: float
    physics: float


def update_times(
    algorithm: Algorithm[Any], state: Any, hyperparameters: Any, environment: Environment
) -> UpdateTimes | None:
    """The times of updates that begin in this state; None if the algorithm learns from every single step.

    The acting is an update of which only the environments' states are kept, so the compiler leaves the
    learning out. The steps begin in the same states, and their actions are random.
    """
    if not hasattr(state, "episodes"):
        return None
    settings: Any = algorithm.settings
    num_steps = settings.env_steps_per_update // algorithm.env_steps_per_time_step
    envs = VectorEnv(repeat_action(environment, settings.action_repeat), algorithm.sharding.mesh)
    shape = (num_steps, settings.num_envs, environment.action_size)
    actions = jax.random.uniform(jax.random.key(0), shape, minval=-1.0, maxval=1.0)

    def experience(state: Any, hyperparameters: Any) -> Any:
        return algorithm.update(state, hyperparameters)[0].episodes

    def physics(states: State, actions: jax.Array) -> State:
        return jax.lax.scan(lambda now, action: (envs.step(now, action), None), states, actions)[0]

    return UpdateTimes(
        _seconds(experience, state, hyperparameters), _seconds(physics, state.episodes.state, actions)
    )


def _seconds(function: Callable[..., Any], *arguments: Any) -> float:
    """The mean of several calls, the first one left out."""
    compiled = jax.jit(function).lower(*arguments).compile(compiler_options())
    jax.block_until_ready(compiled(*arguments))
    began, calls, seconds = time.perf_counter(), 0, 0.0
    while calls < _LEAST_CALLS or seconds < _LEAST_S:
        jax.block_until_ready(compiled(*arguments))
        calls, seconds = calls + 1, time.perf_counter() - began
    return seconds / calls
