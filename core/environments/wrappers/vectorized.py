"""Many copies of an environment side by side, on one device or on several."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec

from core.environments.environment import Environment, State

# The name of the only axis of a mesh: environments lie along it.
ENVS = "envs"


@dataclass(frozen=True)
class VectorEnv:
    """`reset` and `step` of many environments at once.

    mesh: devices along the axis ENVS, each of which steps its own part of the environments, independently of
    the others; None for one device. The results do not depend on it.
    """

    environment: Environment
    mesh: Mesh | None = None

    def reset(self, keys: jax.Array) -> State:
        """A fresh state for each of the keys [N, ...]."""
        num_states, num_parts = len(keys), 1 if self.mesh is None else self.mesh.size
        whole_parts = -(-num_states // num_parts) * num_parts
        filled = jnp.concatenate([keys, jnp.repeat(keys[-1:], whole_parts - num_states, axis=0)])
        states = self._side_by_side(self.environment.reset)(filled if whole_parts > num_states else keys)
        return jax.tree.map(lambda x: x[:num_states], states) if whole_parts > num_states else states

    def step(self, states: State, actions: jax.Array) -> State:
        """The states [N, ...] after an action [N, action_size] each; N is a multiple of the devices."""
        return self._side_by_side(self.environment.step)(states, actions)

    def _side_by_side(self, function: Callable[..., State]) -> Callable[..., State]:
        if self.mesh is None:
            return jax.vmap(function)
        part: Any = PartitionSpec(ENVS)
        # Physics may be a call out of the program, which the compiler does not know how to split.
        return jax.shard_map(
            jax.vmap(function), mesh=self.mesh, in_specs=part, out_specs=part, check_vma=False
        )
