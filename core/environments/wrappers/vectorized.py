"""Many copies of an environment side by side, on one device or on several."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec

from core.environments.environment import Environment, State
from core.environments.wrappers.terrain_levels import at_cell

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

    def reset(self, keys: jax.Array, cells: jax.Array | None = None) -> State:
        """A fresh state for each of the keys [N, ...]. cells: of a terrain, [N] int32; None: any."""
        num_states, num_parts = len(keys), 1 if self.mesh is None else self.mesh.size
        missing = -num_states % num_parts
        inputs = (keys,) if cells is None else (keys, cells)
        if missing:
            inputs = tuple(jnp.concatenate([x, jnp.repeat(x[-1:], missing, axis=0)]) for x in inputs)
        reset = self.environment.reset if cells is None else self._reset_in_cell
        states = self._side_by_side(reset)(*inputs)
        return jax.tree.map(lambda x: x[:num_states], states) if missing else states

    def _reset_in_cell(self, key: jax.Array, cell: jax.Array) -> State:
        return at_cell(self.environment, cell).reset(key)

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
