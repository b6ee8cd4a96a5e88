"""Which device a worker serves; found without loading the numerical stack."""

from pathlib import Path

from core.settings import WorkerSettings

_NVIDIA = Path("/proc/driver/nvidia/gpus")


def device_of(settings: WorkerSettings) -> str:
    """`cpu`, or `gpu:<index>`; `auto` is the first GPU where the driver shows one."""
    if settings.device != "auto":
        return settings.device
    return "gpu:0" if num_gpus() else "cpu"


def num_gpus() -> int:
    """How many NVIDIA GPUs this machine's driver shows."""
    if _NVIDIA.is_dir():
        return len(list(_NVIDIA.iterdir()))
    return len(list(Path("/dev").glob("nvidia[0-9]*")))
