"""The real training process on a CPU that JAX takes for several devices, and that here calls them GPUs.

Nothing else is pretended: the worker's code goes the way that it goes on a machine with GPUs. It prints,
too, over how many devices the run is laid out.
"""

from types import SimpleNamespace

import jax

from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sharding import Sharding
from worker.training.__main__ import main

_over = Sharding.over


def devices() -> list[SimpleNamespace]:
    return [
        SimpleNamespace(platform="gpu", device_kind="Pretended", process_index=0) for _ in jax.local_devices()
    ]


def over(num_devices: int, settings: PPOSpec) -> Sharding:
    sharding = _over(num_devices, settings)
    print(f"laid out over {sharding.mesh.size if sharding.mesh else 1}", flush=True)
    return sharding


if __name__ == "__main__":
    jax.devices = devices
    Sharding.over = staticmethod(over)
    main()
