"""The machine of a measurement."""

import os
import platform
import shutil
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pydantic import BaseModel, ConfigDict

_PACKAGES = ("jax", "brax", "mujoco", "mujoco-mjx")


class Machine(BaseModel):
    """The hardware, the software, the commit and the time."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    processor: str
    cores: int
    accelerator: str | None = None
    memory_gib: float
    system: str
    python: str
    packages: dict[str, str]
    commit: str
    load_before: float
    measured_at: str


def this_machine() -> Machine:
    """This machine now. load_before: the load average of the last minute; well below 1 on a quiet machine."""
    return Machine(
        processor=_processor(),
        cores=num_cores(),
        accelerator=_accelerator(),
        memory_gib=round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        system=f"{platform.system()} {platform.machine()}",
        python=platform.python_version(),
        packages={name: found for name in _PACKAGES if (found := _version(name))},
        commit=_commit(),
        load_before=round(os.getloadavg()[0], 2),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _accelerator() -> str | None:
    """The NVIDIA GPUs, by their driver's names."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return None
    command = [program, "--query-gpu=name", "--format=csv,noheader"]
    names = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split("\n")
    found = [name.strip() for name in names if name.strip()]
    return f"{len(found)} × {found[0]}" if found else None


def num_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    path = Path("/proc/cpuinfo")
    if path.exists():
        for line in path.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _commit() -> str:
    """The commit of this tree, with `+` if it has changes; without a clone, the value of BENCH_COMMIT."""
    if said := os.environ.get("BENCH_COMMIT"):
        return said
    git = shutil.which("git")
    if git is None:
        return "unknown"
    done = subprocess.run(
        [git, "describe", "--always", "--dirty=+", "--exclude=*"], capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"
