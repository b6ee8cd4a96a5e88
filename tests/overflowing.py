"""An environment whose engine loses contacts, as `warp` does where its buffers are full."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from core.environments.environment import State, Wrapped
from core.physics.engine import NOMINAL, OVERFLOW, ModelFields


@dataclass(frozen=True)
class Overflowing(Wrapped):
    """The environment with no room for contacts in the second step of each episode; time counts steps."""

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return _at(self.environment.reset(key, model), jnp.zeros(()))

    def step(self, state: State, action: jax.Array) -> State:
        return _at(self.environment.step(state, action), state.physics.time + 1)


def _at(state: State, time: jax.Array) -> State:
    lost = jnp.where(time == 2, 1.0, 0.0)
    return replace(state, physics=replace(state.physics, time=time, derived={OVERFLOW: lost}))
