"""The device or GPUs that a worker serves, and their memory; found without loading the numerical stack."""

import re
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

from core.devices import device_name, gpu_indices
from core.errors import Misconfigured
from worker.host.memory import allowed_bytes

DEV = Path("/dev")
REMEDY = (
    "In a container: install the NVIDIA Container Toolkit on the host, and start with --profile gpu, which "
    "reserves the GPUs"
)
_TIMEOUT_S = 10.0
_MIB = 2**20


def device_of(wanted: str, dev: Path = DEV, *, has_cuda: bool | None = None) -> str:
    """`cpu`, `gpu:<index>`, or `gpu:<index>,<index>` in rising order, for a value of GAITWAY_DEVICE.

    `auto` is the first GPU if there is one and JAX can use it. has_cuda: whether it can; None: look whether
    it can. Raises Misconfigured if there is no such GPU.
    """
    if wanted == "cpu":
        return "cpu"
    if wanted == "auto":
        usable = jax_has_cuda() if has_cuda is None else has_cuda
        return "gpu:0" if usable and visible_gpus(dev) else "cpu"
    gpu_files(wanted, dev)
    return device_name(gpu_indices(wanted))


def jax_has_cuda() -> bool:
    """Whether JAX's plugin for NVIDIA GPUs is installed; does not load it."""
    return any(find_spec(name) for name in ("jax_cuda12_plugin", "jax_cuda13_plugin"))


def gpu_files(wanted: str, dev: Path = DEV) -> list[str]:
    """The device files of `gpu`, `gpu:0,1` and the like. Raises Misconfigured if one is missing."""
    gpus, indices = visible_gpus(dev), gpu_indices(wanted)
    if not indices or len(set(indices)) < len(indices):
        raise Misconfigured(
            f"GAITWAY_DEVICE={wanted} names {'a GPU twice' if indices else 'no GPU'}. "
            "Write gpu:0,1 or gpu:0-3, with each GPU once."
        )
    if indices[-1] < len(gpus):
        return [gpus[index] for index in indices]
    seen = f"only {len(gpus)}" if gpus else "no NVIDIA GPU"
    raise Misconfigured(
        f"GAITWAY_DEVICE={wanted}, but {seen} {'are' if len(gpus) > 1 else 'is'} visible here. "
        f"{REMEDY}; or set GAITWAY_DEVICE=cpu."
    )


def visible_gpus(dev: Path = DEV) -> list[str]:
    """The device files of the GPUs that this process may use, in their order; those of one host differ.

    The driver's list under /proc would be wrong in a container: it shows all of the host's GPUs.
    """
    numbers = [int(file.name.removeprefix("nvidia")) for file in dev.glob("nvidia*") if _is_gpu(file)]
    if numbers:
        return [f"nvidia{number}" for number in sorted(numbers)]
    return ["dxg"] if (dev / "dxg").exists() else []  # Windows shows its GPU to Linux under this name.


def _is_gpu(file: Path) -> bool:
    return re.fullmatch(r"nvidia\d+", file.name) is not None


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
