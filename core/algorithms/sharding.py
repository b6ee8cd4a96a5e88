"""Where a run's arrays lie when devices share it: environments are split, the rest is on every device."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from core.algorithms.spec import BaseSpec
from core.environments.wrappers.vectorized import ENVS
from core.errors import Rejected

Tree = TypeVar("Tree")


@dataclass(frozen=True)
class Sharding:
    """How arrays lie on the devices of a mesh; None: there is only one device."""

    mesh: Mesh | None = None

    @classmethod
    def over(cls, num_devices: int, settings: BaseSpec) -> "Sharding":
        """Over JAX's first devices.

        Raises Rejected if there are fewer, or they cannot share environments or a minibatch evenly.
        """
        if num_devices == 1:
            return cls()
        found = jax.local_devices()
        if len(found) < num_devices:
            raise Rejected(f"{num_devices} devices were asked for, but JAX finds {len(found)}.")
        settings.check_sharing(num_devices)
        _avoid_a_crash()
        return cls(Mesh(found[:num_devices], (ENVS,)))

    def everywhere(self, tree: Tree) -> Tree:
        """Inside a program: the same arrays, whole on every device."""
        return self._constrained(tree, PartitionSpec())

    def split(self, tree: Tree, axis: int = 0) -> Tree:
        """Inside a program: the same arrays, each device with its part of an axis."""
        return self._constrained(tree, PartitionSpec(*[None] * axis, ENVS))

    def of_axes(self, *axes: str | None) -> NamedSharding | None:
        """For the inputs and outputs of programs; no axes: whole on every device."""
        return None if self.mesh is None else NamedSharding(self.mesh, PartitionSpec(*axes))

    def on_the_first(self, program: Callable[..., Tree]) -> Callable[..., Tree]:
        """Let a program that was compiled for one device take arrays that lie on all of them."""
        if self.mesh is None:
            return program
        return lambda *arrays: program(*jax.device_put(arrays, jax.local_devices()[0]))

    def _constrained(self, tree: Tree, spec: PartitionSpec) -> Tree:
        if self.mesh is None:
            return tree
        sharding: Any = NamedSharding(self.mesh, spec)
        return jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, sharding), tree)


def _avoid_a_crash() -> None:
    """jaxlib 0.11's newer partitioner (Shardy) segfaults on an array without elements in a `shard_map`, and
    MuJoCo's models have many; 0.10 and 0.12 do not."""
    if jax.__version_info__[:2] == (0, 11):
        jax.config.update("jax_use_shardy_partitioner", False)


ONE_DEVICE = Sharding()
