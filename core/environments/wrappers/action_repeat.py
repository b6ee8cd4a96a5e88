"""Acting less often than the environment steps: one action is held for several steps.

In training these are one step (`RepeatedAction`); rollouts and videos take them one at a time (`ActionHold`).
"""

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from core.environments.environment import Environment, State, Wrapped
from core.environments.wrappers.autoreset import select
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


# Entries that are added to `State.info`.
_HELD, _STEPS = "held_action", "steps_taken"


@dataclass(frozen=True)
class ActionHold(Wrapped):
    """The environment step by step; it remembers the last action and the number of steps."""

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return _remembering(self.environment.reset(key, model), jnp.zeros(self.action_size), jnp.int32(0))

    def step(self, state: State, action: jax.Array) -> State:
        steps = state.info[_STEPS]
        inner = replace(state, info=_own(state))
        return _remembering(self.environment.step(inner, action), action, steps + 1)

    @staticmethod
    def due_or_held(state: State, num_steps: int, due: jax.Array) -> jax.Array:
        """[action_size]: `due` once in `num_steps` steps; otherwise the last step's action."""
        return jnp.where(state.info[_STEPS] % num_steps == 0, due, state.info[_HELD])


def _remembering(state: State, action: jax.Array, steps: jax.Array) -> State:
    return replace(state, info={**state.info, _HELD: action, _STEPS: steps})


def _own(state: State) -> dict[str, jax.Array]:
    return {name: value for name, value in state.info.items() if name not in (_HELD, _STEPS)}
