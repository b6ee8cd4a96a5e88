"""Acting more slowly than the world steps: one action, held for several steps."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from core.environments.environment import Environment, State
from core.environments.wrapped import Wrapped
from core.environments.wrappers import select
from core.physics.engine import NOMINAL, ModelFields


@dataclass(frozen=True)
class RepeatedAction(Wrapped):
    """An environment in which every action is taken `num_repeats` times, and rewards add up.

    A step that ends the episode is the last one taken; metrics are those of the last one, as in Brax.
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
        def again(state: State, _: None) -> tuple[State, jax.Array]:
            after = self.environment.step(state, action)
            ended = state.done > 0
            return select(ended, state, after), jnp.where(ended, 0.0, after.reward)

        # `done` may still tell of the episode before this one.
        running = replace(state, done=jnp.zeros_like(state.done))
        last, rewards = jax.lax.scan(again, running, length=self.num_repeats)
        return replace(last, reward=jnp.sum(rewards))


def repeat_action(environment: Environment, num_repeats: int) -> Environment:
    """The environment with every action taken `num_repeats` times; itself where that is once."""
    return environment if num_repeats == 1 else RepeatedAction(environment, num_repeats)
