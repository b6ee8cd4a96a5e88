"""A name for machines that can use each other's compiled programs; found without the numerical stack."""

import hashlib
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from core.errors import Misconfigured
from worker.host.device import DEV, gpu_files

_PACKAGES = (
    "brax",
    "jax",
    "jax-cuda12-plugin",
    "jax-cuda13-plugin",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "warp-lang",
)


def fingerprint(device: str, dev: Path = DEV, proc: Path = Path("/proc")) -> str:
    """Equal for machines that can run each other's programs for this device, different where they may not.

    A program for a CPU uses the instructions of the CPU that compiled it; another may lack some.
    """
    kind = _instructions(proc) if device == "cpu" else _gpu_models(device, dev, proc)
    python = ".".join(platform.python_version_tuple()[:2])
    facts = (platform.system(), platform.machine(), kind, python, *map(_version, _PACKAGES))
    return f"{device.partition(':')[0]}-{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _instructions(proc: Path) -> str:
    """The instruction sets of the CPU, sorted; its cores are assumed to be equal."""
    found = re.search(r"^(?:flags|Features)\s*:(.*)$", _text(proc / "cpuinfo"), re.MULTILINE)
    return " ".join(sorted(found[1].split())) if found else platform.processor()


def _gpu_models(device: str, dev: Path, proc: Path) -> str:
    """The driver's names; empty if it gives none, as under Windows: then JAX's own keys tell models apart.

    Those keys also tell programs for several GPUs from programs for one.
    """
    try:
        numbers = {file.removeprefix("nvidia") for file in gpu_files(device, dev)}
    except Misconfigured:  # It has just gone, and the job will say so.
        return ""
    models = set[str]()
    for facts in map(_text, proc.glob("driver/nvidia/gpus/*/information")):
        number = re.search(r"^Device Minor:\s*(\d+)$", facts, re.MULTILINE)
        model = re.search(r"^Model:\s*(.*)$", facts, re.MULTILINE)
        if number and model and number[1] in numbers:
            models.add(model[1].strip())
    return ", ".join(sorted(models))


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
