"""The part of the machine's memory that a training may take, and whether the kernel killed it for more."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from core.variables import variable
from worker.host.cgroup import NO_GROUP, TrainingGroup
from worker.host.processes import processes

LESS_MEMORY = "Lower num_envs, batch_size or unroll_length, or make the networks smaller."
# Memory that is reserved for the worker and its supervisor.
_LEAST_RESERVE_BYTES, _RESERVE = 2**29, 0.05
_GROUP_EVERY_S = 1.0
_ROOT = Path("/")
_GIB = 2**30


class MemoryWatch:
    """Watches the memory of a training's processes, and how often the kernel has killed for memory.

    RLIMIT_DATA is no alternative: XLA crashes (SIGSEGV) when it is refused memory, and the reason is lost.
    limit_bytes: for all processes together. group: a control group in which the kernel enforces the limit,
    too; a worker is seldom allowed to make one.
    """

    def __init__(
        self,
        limit_bytes: int,
        root: Path = _ROOT,
        clock: Callable[[], float] = time.monotonic,
        group: TrainingGroup = NO_GROUP,
    ) -> None:
        self._limit_bytes = limit_bytes
        self._root = root
        self._clock = clock
        self._group = group
        self._looked_at = clock()
        self._kills = self._before = kernel_kills(root)

    def what_is_wrong(self, group: int) -> str | None:
        """A sentence if the processes of the group use too much memory; group: also the id of its leader."""
        has = memory_of(group, self._root)
        now = self._clock()
        if now - self._looked_at >= _GROUP_EVERY_S:
            self._looked_at = now
            # The newest count may include the death that `ran_out` asks about, so it needs the one before.
            self._before, self._kills = self._kills, kernel_kills(self._root)
            has = sum(memory_of(pid, self._root) for pid in _members(group, self._root))
        if has <= self._limit_bytes:
            return None
        return (
            f"The training took {has / _GIB:.1f} GiB of the worker's memory and was ended: "
            f"{variable('memory_limit')} allows {self._limit_bytes / _GIB:.1f} GiB. {LESS_MEMORY}"
        )

    def ran_out(self) -> bool:
        """Whether the kernel has killed a process for memory in the last seconds."""
        return self._group.ran_out() or kernel_kills(self._root) > self._before


def allowed_bytes(setting: int | None, root: Path = _ROOT) -> int:
    """The bytes that a training may take: the setting, or the memory of machine or container, less some."""
    if setting is not None:
        return setting
    has = _has_bytes(root)
    return max(has // 2, has - max(_LEAST_RESERVE_BYTES, int(_RESERVE * has)))


def kernel_kills(root: Path = _ROOT) -> int:
    """The number of processes that the kernel killed for memory, in this container or on this machine."""
    files = [folder / "memory.events" for folder in _cgroups(root)]
    for file in (*files, root / "proc/vmstat"):
        with suppress(OSError):
            for line in file.read_text().splitlines():
                name, _, value = line.partition(" ")
                if name == "oom_kill":
                    return int(value)
    return 0


def memory_of(pid: int, root: Path = _ROOT) -> int:
    """The bytes of memory that belong to a process alone; 0 if it has ended."""
    with suppress(OSError):
        for line in (root / f"proc/{pid}/status").read_text().splitlines():
            if line.startswith("RssAnon:"):
                return 1024 * int(line.split()[1])
    return 0


def sacrifice(pid: int) -> None:
    """Make the kernel kill this process, or what it will start, before any other when memory runs out."""
    with suppress(OSError):  # It has ended, or there is no such file here.
        Path(f"/proc/{pid}/oom_score_adj").write_text("1000")


def _members(group: int, root: Path) -> Iterator[int]:
    return (pid for pid, _, its_group in processes(root / "proc") if its_group == group)


def _has_bytes(root: Path) -> int:
    """The memory of the machine, or of the container if that has less."""
    try:
        limits = [1024 * int((root / "proc/meminfo").read_text().split()[1])]
    except OSError:  # Not Linux.
        limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    names = [folder / "memory.max" for folder in _cgroups(root)]
    for file in (*names, root / "sys/fs/cgroup/memory/memory.limit_in_bytes"):
        with suppress(OSError, ValueError):  # `max` is no number.
            limits.append(int(file.read_text()))
    return min(limits)


def _cgroups(root: Path) -> list[Path]:
    """This process' own control group and those around it, the innermost first (cgroups(7), version 2)."""
    top = root / "sys/fs/cgroup"
    with suppress(OSError):
        for line in (root / "proc/self/cgroup").read_text().splitlines():
            if line.startswith("0::/"):
                own = top / line.removeprefix("0::/").strip("/")
                return [own, *own.parents[: len(own.parts) - len(top.parts)]]
    return [top]
