"""A training process's part in a job that several hosts share."""

import os
import sys
from typing import NoReturn

import jax

from core.algorithms.hosts import Hosts
from worker.protocol import GangPart

# How long the processes wait for each other to start, in seconds: one may have a slow disk.
_START_S = 600


def join(part: GangPart) -> None:
    """Connect to the processes of the other hosts; call it before anything else of JAX."""
    # Each host compiles for itself: where only some have a program in their cache, the others would wait in
    # vain for the share of the tuning that these skip.
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_gpu_shard_autotuning=false".strip()
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.distributed.initialize(
        part.coordinator,
        part.hosts,
        part.rank,
        # Slurm's variables would give each process one of its GPUs.
        cluster_detection_method="deactivate",
        coordinator_bind_address=part.bind,
        initialization_timeout=_START_S,
    )


def check_equal(engine: str) -> None:
    """Raises JobFailed if the hosts would not run the same program."""
    Hosts().agree(f"the engine {engine}, and {len(jax.local_devices())} devices")


def leave(status: int) -> NoReturn:
    """End this process. One that shares a job does not wait for the others, of which one may be lost."""
    if not jax.distributed.is_initialized():
        sys.exit(status)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
