"""Checks whether a run fits into memory, before any of it is allocated."""

import jax

from core.algorithms.memory import Memory
from core.environments.info import Device
from core.errors import JobFailed
from core.reasons import Reason
from worker.host.memory import allowed_bytes


def check_memory(least: Memory, device: Device) -> None:
    """Raises JobFailed if the device, or for a CPU its machine, has less memory than the run needs."""
    limit = allowed_bytes(None) if device == "cpu" else _device_bytes()
    if limit is not None and least.bytes > limit:
        # Not `out_of_host_memory`, which another process may have caused and which is retried.
        raise JobFailed(Reason.OUT_OF_MEMORY, least.does_not_fit(limit, f"this worker's {device.upper()}"))


def _device_bytes() -> int | None:
    """The memory of the first GPU that XLA may use, in bytes; None if XLA does not say."""
    counted = jax.local_devices()[0].memory_stats()
    return counted.get("bytes_limit") if counted else None
