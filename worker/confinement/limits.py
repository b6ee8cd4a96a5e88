"""The limits of a process that reads a stranger's model."""

import os
import resource
from contextlib import suppress
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Limits:
    """wall_s: from start to kill. cpu_s: of all its threads. memory_bytes: of its address space.

    num_processes: and threads, besides those that its user has already. The kernel does not hold root to it.
    """

    wall_s: float = 90.0
    cpu_s: int = 90
    memory_bytes: int = 6 * 2**30
    file_bytes: int = 512 * 2**20
    num_files: int = 256
    num_cores: int = 2
    num_processes: int = 512

    def arguments(self) -> list[str]:
        return [str(value) for value in asdict(self).values()]

    @classmethod
    def of(cls, arguments: list[str]) -> "Limits":
        wall, *rest = arguments
        return cls(float(wall), *map(int, rest))


def limit(limits: Limits) -> None:
    """Limit this process and all it starts, for good. Raises OSError."""
    for what, most in (
        (resource.RLIMIT_CPU, limits.cpu_s),
        (resource.RLIMIT_FSIZE, limits.file_bytes),
        (resource.RLIMIT_NOFILE, limits.num_files),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_AS, limits.memory_bytes),
        (resource.RLIMIT_NPROC, limits.num_processes + _num_of_user()),
    ):
        _, hard = resource.getrlimit(what)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (most, most))
    # Libraries start a thread for each core that they see, and each takes memory.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: limits.num_cores])


def _num_of_user() -> int:
    """Processes and threads of this user now."""
    number = 0
    for process in os.scandir("/proc"):
        with suppress(OSError):  # It has ended.
            if process.name.isdigit() and process.stat().st_uid == os.getuid():
                number += len(os.listdir(f"/proc/{process.name}/task"))
    return number
