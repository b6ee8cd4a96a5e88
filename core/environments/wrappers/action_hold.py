"""Acting more slowly than the world steps, seen step by step: for rollouts and videos.

In training a held action is one step (`action_repeat`).
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from core.environments.environment import State
from core.environments.wrappers.base import Wrapped
from core.physics.engine import NOMINAL, ModelFields

# What is kept in `State.info`, besides what is there.
_HELD, _STEPS = "held_action", "steps_taken"


@dataclass(frozen=True)
class ActionHold(Wrapped):
    """The environment step by step, which remembers the action that is held, and since when."""

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return _remembering(self.environment.reset(key, model), jnp.zeros(self.action_size), jnp.int32(0))

    def step(self, state: State, action: jax.Array) -> State:
        steps = state.info[_STEPS]
        inner = replace(state, info=_own(state))
        return _remembering(self.environment.step(inner, action), action, steps + 1)

    @staticmethod
    def due_or_held(state: State, num_steps: int, due: jax.Array) -> jax.Array:
        """[action_size]: what is due, once in so many steps; in the others the last step's action."""
        return jnp.where(state.info[_STEPS] % num_steps == 0, due, state.info[_HELD])


def _remembering(state: State, action: jax.Array, steps: jax.Array) -> State:
    return replace(state, info={**state.info, _HELD: action, _STEPS: steps})


def _own(state: State) -> dict[str, jax.Array]:
    return {name: value for name, value in state.info.items() if name not in (_HELD, _STEPS)}
