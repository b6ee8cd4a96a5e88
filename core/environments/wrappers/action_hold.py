"""Acting less often than the environment steps, one step at a time: for rollouts and videos.

In training a held action is one step (`action_repeat`).
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from core.environments.environment import State
from core.environments.wrappers.base import Wrapped
from core.physics.engine import NOMINAL, ModelFields

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
