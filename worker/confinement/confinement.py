"""Limits and confines a process before it reads a stranger's model. It imports only the standard library.

Every layer holds, or the process ends before it has read a byte.
"""

import os
import resource
import site
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from worker.confinement import landlock, privileges, seccomp

Layer = Literal["limits", "privileges", "user", "files", "calls"]
_CODE = Path(__file__).resolve().parents[2]
# Programs and libraries, and what these ask about the machine. Nothing of /etc but the linker's list.
_SYSTEM = (
    *("/usr", "/lib", "/lib64", "/bin", "/nix/store"),
    *("/etc/ld.so.cache", "/etc/localtime", "/dev/null", "/dev/zero", "/dev/urandom"),
    *("/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/self", "/sys/devices/system/cpu"),
)
PACKAGES = ("core", "mujoco_compiled", "worker", "gaitway")


@dataclass(frozen=True)
class Limits:
    """wall_s: from start to kill. cpu_s: of all its threads, and what `allow_cpu` may add to it: more_cpu_s.
    memory_bytes: of its address space.

    num_processes: and threads, besides those that its user has already. The kernel does not hold root to it.
    """

    wall_s: float = 90.0
    cpu_s: int = 90
    memory_bytes: int = 6 * 2**30
    file_bytes: int = 512 * 2**20
    num_files: int = 256
    num_cores: int = 2
    num_processes: int = 512
    more_cpu_s: int = 0

    def arguments(self) -> list[str]:
        return [str(value) for value in asdict(self).values()]

    @classmethod
    def of(cls, arguments: list[str]) -> "Limits":
        wall, *rest = arguments
        return cls(float(wall), *map(int, rest))


def limit(limits: Limits) -> None:
    """Limit this process and all it starts, for good. Raises OSError."""
    for what, most in (
        (resource.RLIMIT_CPU, limits.cpu_s + limits.more_cpu_s),
        (resource.RLIMIT_FSIZE, limits.file_bytes),
        (resource.RLIMIT_NOFILE, limits.num_files),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_AS, limits.memory_bytes),
        (resource.RLIMIT_NPROC, limits.num_processes + _num_of_user()),
    ):
        _, hard = resource.getrlimit(what)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        soft = min(most, limits.cpu_s) if what == resource.RLIMIT_CPU else most
        resource.setrlimit(what, (soft, most))
    # Libraries start a thread for each core that they see, and each takes memory.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: limits.num_cores])


def allow_cpu(seconds: int) -> None:
    """Let this process take so much more processor time, as far as `more_cpu_s` goes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_CPU)
    if soft != resource.RLIM_INFINITY:
        resource.setrlimit(resource.RLIMIT_CPU, (min(soft + seconds, hard), hard))


def _num_of_user() -> int:
    """Processes and threads of this user now."""
    number = 0
    for process in os.scandir("/proc"):
        with suppress(OSError):  # It has ended.
            if process.name.isdigit() and process.stat().st_uid == os.getuid():
                number += len(os.listdir(f"/proc/{process.name}/task"))
    return number


class Unconfined(Exception):
    """A layer does not hold here; the message says which and why."""


def confine(limits: Limits, folder: Path, *, strictly: bool = True) -> tuple[Layer, ...]:
    """Confine this process and all it starts, for good, to the limits and its folder; returns the layers.

    "limits" on time, memory and files; a "user" of its own, where this is root and Python is open to all; no
    "privileges"; no "files" but its own and those of programs and libraries; no "calls" that make sockets,
    reach other processes or mount. Where the kernel has no Landlock, only a user of its own keeps it from the
    worker's files. strictly: raises Unconfined if a layer fails, or if neither of these two holds.
    """
    held = list[Layer]()
    steps: tuple[tuple[Layer, Callable[[], object]], ...] = (
        ("limits", lambda: limit(limits)),
        ("user", lambda: privileges.become_nobody(folder)),
        ("privileges", privileges.give_up),
        ("files", lambda: _keep_to(folder)),
        ("calls", seccomp.refuse_calls),
    )
    for layer, step in steps:
        try:
            if step() is not False:
                held.append(layer)
        # A system other than Linux lacks the functions themselves.
        except (OSError, ValueError, AttributeError) as error:
            if strictly:
                raise Unconfined(f"{layer}: {error}") from error
    if strictly and not {"user", "files"} & set(held):
        raise Unconfined(
            "files: this kernel has no Landlock (Linux 5.13 or newer, and switched on), and the worker is no "
            "root whose Python and GAITWAY_DATA_DIR are open to other users"
        )
    return tuple(held)


def plugin_folders() -> Iterator[Path]:
    """Those of packages that add environments: one that is installed as editable lies anywhere."""
    for point in entry_points(group="gaitway.environments"):
        spec = find_spec(point.module.partition(".")[0])
        if spec is not None:
            yield from map(Path, spec.submodule_search_locations or [spec.origin or ""])


def _keep_to(folder: Path) -> bool:
    """False if there is no Landlock."""
    if not landlock.version():
        return False
    libraries = {
        site.getusersitepackages() if site.ENABLE_USER_SITE else "",
        sys.prefix,
        sys.base_prefix,
        sys.exec_prefix,
        *os.environ.get("LD_LIBRARY_PATH", "").split(":"),
    }
    plugins = [folder for folder in plugin_folders() if folder.exists()]
    landlock.restrict(
        readable=[
            *map(Path, _SYSTEM),
            *map(Path, libraries - {"", "/"}),
            *(_CODE / name for name in PACKAGES),
            *plugins,
        ],
        # Python lists the folders that it looks for modules in. The checkout may hold an `.env`.
        listable=[_CODE, *(folder.parent for folder in plugins)],
        writable=[folder, Path("/dev/null")],
    )
    return True
