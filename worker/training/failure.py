"""Turns the exception that ended a training process into its last message."""

import re

from core.reasons import Reason
from worker.host.disk import is_full, what_to_do
from worker.host.memory import LESS_MEMORY
from worker.protocol import Failed

# XLA's word, and Warp's.
_DEVICE_MEMORY = re.compile(
    r"RESOURCE_EXHAUSTED|CUDA_ERROR_OUT_OF_MEMORY|Failed to allocate \d+ bytes on device"
)
# CUDA's words, as XLA and Warp pass them on, and those of the driver.
_DEVICE_FAILED = re.compile(
    r"CUDA_ERROR_|Warp CUDA error|CUDA error|\bECC\b|device is lost|fallen off the bus|\bXid\b", re.IGNORECASE
)


def failure(error: Exception, device: str) -> Failed:
    """Blames memory, device or disk if it was one of these. device: `cpu`, or the worker's GPUs."""
    if is_full(error):
        return Failed(reason=Reason.STORAGE_UNAVAILABLE, message=what_to_do())
    text = f"{type(error).__name__}: {error}"
    line = text.splitlines()[0][:500]
    has_no_memory = _DEVICE_MEMORY.search(text) is not None
    # Native physics reports a lack of memory through XLA, and by Python's name for it.
    if "MemoryError" in text or (has_no_memory and device == "cpu"):
        return Failed(
            reason=Reason.OUT_OF_HOST_MEMORY, message=f"The worker's memory ran out. {LESS_MEMORY} {line}"
        )
    if has_no_memory:
        message = f"The memory of {device} ran out. {LESS_MEMORY} {line}"
        return Failed(reason=Reason.OUT_OF_MEMORY, message=message)
    if device != "cpu" and _DEVICE_FAILED.search(text):
        return Failed(reason=Reason.DEVICE_FAILED, message=f"The device {device} reported an error. {line}")
    return Failed(reason=Reason.TRAINING_CRASHED, message=f"{line} (the log has the traceback)")
