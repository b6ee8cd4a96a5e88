"""This project's environments in the form that Brax's trainer takes."""

from typing import Any

import jax
from brax.envs.base import Env
from brax.envs.base import State as BraxState

from core.environments.environment import Environment, State


class BraxEnvironment(Env):
    """The same physics, observations and rewards, behind Brax's interface."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def reset(self, rng: jax.Array) -> BraxState:
        state = self._environment.reset(rng)
        return BraxState(
            pipeline_state=state.physics,  # pyright: ignore[reportArgumentType]
            obs=state.obs,
            reward=state.reward,
            done=state.done,
            metrics=dict(state.metrics),
            info=dict(state.info),
        )

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        before: Any = State(
            physics=state.pipeline_state,  # pyright: ignore[reportArgumentType]
            obs=state.obs,  # pyright: ignore[reportArgumentType]
            reward=state.reward,
            done=state.done,
            metrics=state.metrics,
            info=state.info,
        )
        after = self._environment.step(before, action)
        # Brax's wrappers keep values of their own in both mappings: metrics are updated, not replaced.
        return state.replace(  # pyright: ignore[reportAttributeAccessIssue]
            pipeline_state=after.physics,
            obs=after.obs,
            reward=after.reward,
            done=after.done,
            metrics={**state.metrics, **after.metrics},
            info={**state.info, **after.info},
        )

    @property
    def observation_size(self) -> int:
        return self._environment.observation_size

    @property
    def action_size(self) -> int:
        return self._environment.action_size

    @property
    def backend(self) -> str:
        return "mjx"
