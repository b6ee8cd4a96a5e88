"""A control group for a training, in which the kernel enforces its memory limit (cgroups(7), version 2).

It is made beside the worker's group and not inside it: a group that holds processes cannot limit groups
below it. So the worker must be allowed to write to the folder around its own group, as in a systemd unit with
`Delegate=memory` and `DelegateSubgroup=`. In a container it seldom is; then there is no group.
"""

import os
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import structlog

log = structlog.get_logger()

_ROOT = Path("/")
_NAME = "gaitway-training-"
_TIMEOUT_S, _PAUSE_S = 5.0, 0.01


@dataclass(frozen=True)
class TrainingGroup:
    """folder: None if there is no such group."""

    folder: Path | None = None

    def ran_out(self) -> bool:
        """Whether the kernel has killed this training for taking more than it may."""
        if self.folder is not None:
            with suppress(OSError):
                for line in (self.folder / "memory.events").read_text().splitlines():
                    name, _, value = line.partition(" ")
                    if name == "oom_kill":
                        return int(value) > 0
        return False


NO_GROUP = TrainingGroup()


@contextmanager
def memory_group(pid: int, limit_bytes: int, root: Path = _ROOT) -> Generator[TrainingGroup]:
    """Limits the process and all that it will start to `limit_bytes`; at the block's end none of it is left.

    If the kernel has to kill one of them for memory, it kills all. Without such a group, this does nothing.
    """
    folder = None
    try:
        parent = _parent(root)
        folder = None if parent is None else _made(parent, pid, limit_bytes)
    except OSError as error:  # The folder looked writable, and the kernel refused.
        log.info("no_memory_group", error=str(error))
    try:
        yield TrainingGroup(folder)
    finally:
        if folder is not None:
            _end(folder)


def _parent(root: Path) -> Path | None:
    """The group around the worker's own, if it can limit the memory of new groups. Raises OSError."""
    top = root / "sys/fs/cgroup"
    if not (top / "cgroup.controllers").exists():  # Version 1, or both versions.
        return None
    own = next(
        line.removeprefix("0::/")
        for line in (root / "proc/self/cgroup").read_text().splitlines()
        if line.startswith("0::/")
    )
    parent = (top / own).parent
    if not own or not all(os.access(path, os.W_OK) for path in (parent, parent / "cgroup.procs")):
        return None
    if "memory" not in (parent / "cgroup.subtree_control").read_text().split():
        # The kernel refuses it where the group has processes of its own.
        (parent / "cgroup.subtree_control").write_text("+memory")
    return parent


def _made(parent: Path, pid: int, limit_bytes: int) -> Path:
    for old in parent.glob(f"{_NAME}*"):
        with suppress(OSError):  # It has processes: another worker's training.
            old.rmdir()
    folder = parent / f"{_NAME}{pid}"
    folder.mkdir()
    try:
        (folder / "memory.max").write_text(str(limit_bytes))
        (folder / "memory.oom.group").write_text("1")
        with suppress(FileNotFoundError):  # A kernel without swap.
            (folder / "memory.swap.max").write_text("0")
        (folder / "cgroup.procs").write_text(str(pid))
    except OSError:
        _end(folder)
        raise
    return folder


def _end(folder: Path) -> None:
    """Kill what is left in it, even outside the training's process group, and remove it."""
    deadline = time.monotonic() + _TIMEOUT_S
    with suppress(OSError):  # Linux 5.14 or newer.
        (folder / "cgroup.kill").write_text("1")
    while True:
        try:
            folder.rmdir()
        except FileNotFoundError:
            return
        except OSError as error:  # A killed process is still ending.
            if time.monotonic() > deadline:
                log.warning("memory_group_left", folder=str(folder), error=str(error))
                return
            time.sleep(_PAUSE_S)
        else:
            return
