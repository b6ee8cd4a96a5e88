"""The machine of a measurement, in words, and the commit of the code."""

import os
import platform
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path

_PACKAGES = ("jax", "brax", "mujoco")


def this_machine() -> str:
    """Its accelerator, processor, cores, memory, versions, and the load average of the last minute."""
    memory_gib = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    parts = [
        *_accelerator(),
        _processor(),
        f"{num_cores()} cores",
        f"{memory_gib:.1f} GiB",
        f"Python {platform.python_version()}",
        *(f"{name} {version(name)}" for name in _PACKAGES),
    ]
    return f"{', '.join(parts)}; load {os.getloadavg()[0]:.2f} before it began"


def num_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def this_commit() -> str:
    """The commit of this tree, with `+` if it has changes; without a clone, the value of BENCH_COMMIT."""
    if told := os.environ.get("BENCH_COMMIT"):
        return told
    git = shutil.which("git")
    if git is None:
        return "unknown"
    command = [git, "describe", "--always", "--dirty=+", "--exclude=*"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def _accelerator() -> list[str]:
    """The NVIDIA GPUs, by their driver's names."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return []
    command = [program, "--query-gpu=name", "--format=csv,noheader"]
    names = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split("\n")
    found = [name.strip() for name in names if name.strip()]
    return [f"{len(found)} × {found[0]}"] if found else []


def _processor() -> str:
    path = Path("/proc/cpuinfo")
    if path.exists():
        for line in path.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "an unknown processor"
