"""Where a run's arrays lie when devices share it: environments are split, the rest is on every device.

The devices may be those of several processes, each on a host of its own (`core.algorithms.hosts`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import numpy as np
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
        """Over JAX's first devices, with an equal number in each process.

        Raises Rejected if there are fewer, or they cannot share environments or a minibatch evenly.
        """
        if num_devices == 1:
            return cls()
        num_hosts = jax.process_count()
        here = num_devices // num_hosts
        found = [one for rank in range(num_hosts) for one in jax.local_devices(process_index=rank)[:here]]
        if len(found) < num_devices:
            raise Rejected(f"{num_devices} devices were asked for, but JAX finds {len(found)}.")
        settings.check_sharing(num_devices)
        _avoid_a_crash()
        return cls(Mesh(found, (ENVS,)))

    def everywhere(self, tree: Tree) -> Tree:
        """Inside a program: the same arrays, whole on every device."""
        return self._constrained(tree, PartitionSpec())

    def split(self, tree: Tree, axis: int = 0) -> Tree:
        """Inside a program: the same arrays, each device with its part of an axis."""
        return self._constrained(tree, PartitionSpec(*[None] * axis, ENVS))

    def of_axes(self, *axes: str | None) -> NamedSharding | None:
        """For the inputs and outputs of programs; no axes: whole on every device."""
        return None if self.mesh is None else NamedSharding(self.mesh, PartitionSpec(*axes))

    @property
    def has_other_hosts(self) -> bool:
        """Whether some of the devices belong to other processes."""
        return self.mesh is not None and self.mesh.is_multi_process

    def put(self, tree: Tree, shardings: Any) -> Tree:
        """Arrays of the host, which are the same in every process, as arrays on the devices.

        shardings: of all arrays, or a tree of them.
        """
        if not self.has_other_hosts:
            return jax.device_put(tree, shardings)
        # `jax.device_put` would first compare them among all processes.
        if isinstance(shardings, NamedSharding):
            shardings = jax.tree.map(lambda _: shardings, tree)
        return jax.tree.map(_laid_out, tree, shardings)

    def on_the_first(self, program: Callable[..., Tree]) -> Callable[..., Tree]:
        """Let a program that was compiled for one device take arrays that lie whole on all of them; each
        process runs it on its own first device."""
        if self.mesh is None:
            return program
        first = jax.local_devices()[0]
        return lambda *arrays: program(
            *jax.device_put(jax.tree.map(lambda x: x.addressable_data(0), arrays), first)
        )

    def _constrained(self, tree: Tree, spec: PartitionSpec) -> Tree:
        if self.mesh is None:
            return tree
        sharding: Any = NamedSharding(self.mesh, spec)
        return jax.tree.map(lambda x: jax.lax.with_sharding_constraint(x, sharding), tree)


def _laid_out(array: Any, sharding: NamedSharding) -> jax.Array:
    array = np.asarray(array)
    return jax.make_array_from_callback(array.shape, sharding, lambda part: array[part])


def _avoid_a_crash() -> None:
    """jaxlib 0.11's newer partitioner (Shardy) segfaults on an array without elements in a `shard_map`, and
    MuJoCo's models have many; 0.10 and 0.12 do not."""
    if jax.__version_info__[:2] == (0, 11):
        jax.config.update("jax_use_shardy_partitioner", False)


ONE_DEVICE = Sharding()
