"""Acting less often than the environment steps: one action is held for several steps."""

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from core.environments.environment import Environment, State
from core.environments.wrappers.autoreset import select
from core.environments.wrappers.base import Wrapped
from core.physics.engine import NOMINAL, OVERFLOW, ModelFields


@dataclass(frozen=True)
class RepeatedAction(Wrapped):
    """An environment in which every action is taken `num_repeats` times, and rewards add up.

    A step that ends the episode is the last one taken. Metrics are means over `num_repeats` steps, where
    steps that are not taken count as 0, so an action's sum is `num_repeats` times its metric. (Brax keeps
    only the metrics of the last step.) If the engine has `OVERFLOW`, it is 1 if any of the steps lost
    contacts.
    """

    num_repeats: int

    @property
    def dt(self) -> float:
        return self.environment.dt * self.num_repeats

    @property
    def episode_length(self) -> int:
        return -(-self.environment.episode_length // self.num_repeats)

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return self.environment.reset(key, model)

    def step(self, state: State, action: jax.Array) -> State:
        def again(state: State, _: None) -> tuple[State, Any]:
            after = self.environment.step(state, action)
            ended = state.done > 0
            seen = (after.reward, dict(after.metrics), after.physics.derived.get(OVERFLOW))
            return select(ended, state, after), jax.tree.map(lambda x: jnp.where(ended, 0.0, x), seen)

        # `done` may still be that of the last episode.
        running = replace(state, done=jnp.zeros_like(state.done))
        last, (rewards, metrics, lost) = jax.lax.scan(again, running, length=self.num_repeats)
        means = {name: jnp.sum(values) / self.num_repeats for name, values in metrics.items()}
        physics = last.physics
        if lost is not None:
            physics = replace(physics, derived={**physics.derived, OVERFLOW: jnp.max(lost)})
        return replace(last, physics=physics, reward=jnp.sum(rewards), metrics=means)


def repeat_action(environment: Environment, num_repeats: int) -> Environment:
    """The environment with every action taken `num_repeats` times; unchanged if that is once."""
    return environment if num_repeats == 1 else RepeatedAction(environment, num_repeats)
