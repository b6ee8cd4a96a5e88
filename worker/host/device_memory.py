"""The memory of a worker's device, found without loading the numerical stack."""

import shutil
import subprocess

from core.devices import gpu_indices
from worker.host.memory import allowed_bytes

_TIMEOUT_S = 10.0
_MIB = 2**20


def device_memory(device: str, memory_limit: int | None) -> int | None:
    """The bytes that a training may take of the machine's memory, for `cpu`; or those of the smallest GPU.

    memory_limit: the setting. None if nvidia-smi is missing or does not know the GPU.
    """
    indices = gpu_indices(device)
    if not indices:
        return allowed_bytes(memory_limit)
    program = shutil.which("nvidia-smi")
    if program is None:
        return None
    asked = [
        "--query-gpu=memory.total",
        "--format=csv,noheader,nounits",
        f"--id={','.join(map(str, indices))}",
    ]
    try:
        said = subprocess.run(
            [program, *asked], capture_output=True, text=True, timeout=_TIMEOUT_S, check=True
        )
        return _MIB * min(int(line) for line in said.stdout.splitlines())
    except (OSError, subprocess.SubprocessError, ValueError):
        return None
