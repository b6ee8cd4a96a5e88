"""Which device a worker serves; found without loading the numerical stack."""

import re
from pathlib import Path

from core.configuration import variable
from core.errors import Misconfigured
from core.settings import WorkerSettings

DEV = Path("/dev")
REMEDY = (
    "In a container: install the NVIDIA Container Toolkit on the host, and start with --profile gpu, which "
    "reserves the GPUs"
)


def device_of(settings: WorkerSettings, dev: Path = DEV) -> str:
    """`cpu`, or `gpu:<index>`; `auto` is the first GPU if there is one.

    Raises Misconfigured where there is no such GPU.
    """
    num_gpus = len(visible_gpus(dev))
    match settings.device:
        case "cpu":
            return "cpu"
        case "auto":
            return "gpu:0" if num_gpus else "cpu"
        case wanted:
            index = int(wanted.partition(":")[2] or 0)
    if index >= num_gpus:
        seen = f"only {num_gpus}" if num_gpus else "no NVIDIA GPU"
        raise Misconfigured(
            f"{variable('device')}={wanted}, but {seen} {'are' if num_gpus > 1 else 'is'} visible here. "
            f"{REMEDY}; or set {variable('device')}=cpu."
        )
    return f"gpu:{index}"


def visible_gpus(dev: Path = DEV) -> list[str]:
    """The device files of the GPUs that this process may use, in their order; those of one host differ.

    What the driver tells under /proc would be wrong in a container: there all of the host's GPUs show.
    """
    numbers = [int(file.name.removeprefix("nvidia")) for file in dev.glob("nvidia*") if _is_gpu(file)]
    if numbers:
        return [f"nvidia{number}" for number in sorted(numbers)]
    return ["dxg"] if (dev / "dxg").exists() else []  # Windows shows its GPU to Linux under this name.


def _is_gpu(file: Path) -> bool:
    return re.fullmatch(r"nvidia\d+", file.name) is not None
