"""A name for machines that can use each other's compiled programs; found without the numerical stack."""

import hashlib
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from core.errors import Misconfigured
from worker.device import DEV, gpu_file

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
    """Equal where what is compiled for this device runs, and different where it may not.

    Programs for a CPU hold whatever instructions the one that compiled them has; another may lack some.
    """
    kind = _instructions(proc) if device == "cpu" else _gpu_model(device, dev, proc)
    python = ".".join(platform.python_version_tuple()[:2])
    facts = (platform.system(), platform.machine(), kind, python, *map(_version, _PACKAGES))
    return f"{device.partition(':')[0]}-{hashlib.sha256(repr(facts).encode()).hexdigest()[:16]}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _instructions(proc: Path) -> str:
    """What the CPU can do, in one order; its cores are taken to be equal."""
    found = re.search(r"^(?:flags|Features)\s*:(.*)$", _text(proc / "cpuinfo"), re.MULTILINE)
    return " ".join(sorted(found[1].split())) if found else platform.processor()


def _gpu_model(device: str, dev: Path, proc: Path) -> str:
    """As the driver calls it; nothing where it does not say, as under Windows: JAX's own keys tell then."""
    try:
        number = gpu_file(device, dev).removeprefix("nvidia")
    except Misconfigured:  # It has just gone, and the job will say so.
        return ""
    for facts in map(_text, sorted(proc.glob("driver/nvidia/gpus/*/information"))):
        if re.search(rf"^Device Minor:\s*{number}$", facts, re.MULTILINE):
            found = re.search(r"^Model:\s*(.*)$", facts, re.MULTILINE)
            return found[1].strip() if found else ""
    return ""


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
