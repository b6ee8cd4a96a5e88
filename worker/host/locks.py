"""Locks that the kernel releases when their holder ends, however it ends; the locks of devices among them.

One device, one job: the process that uses a device holds its lock, even when its supervisor is gone. A job on
several GPUs holds the locks of all of them; jobs that share a GPU share its lock, too.
"""

import fcntl
import os
import socket
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from core.retry import pause
from worker.host.device import DEV, gpu_files

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_PID_NAMESPACE = Path("/proc/self/ns/pid")


def take_lock(path: Path, *, shared: bool = False) -> int | None:
    """The descriptor of this file, locked; None if another process holds it or has just removed it.

    A process that inherits the descriptor holds the lock, too. shared: others may hold it as well, if they
    share it.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    with suppress(BlockingIOError, FileNotFoundError):
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), path.stat()):
            return descriptor
    os.close(descriptor)
    return None


def share_lock(path: Path, descriptor: int) -> int:
    """Let others share a lock that nobody else holds; returns its descriptor, which may be a new one.

    Who takes it in between, to look at it, is waited for; and may have removed the file.
    """
    fcntl.flock(descriptor, fcntl.LOCK_SH)
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(descriptor), path.stat()):
            return descriptor
    os.close(descriptor)
    return _wait_for(path, float("inf"), lambda: False, shared=True)


def remove_lock(path: Path, descriptor: int) -> None:
    """Release a lock that nobody else holds, and remove its file."""
    path.unlink(missing_ok=True)
    os.close(descriptor)


def is_held(path: Path) -> bool:
    """Whether a process holds this lock. Where there is no file, nobody is disturbed by the question."""
    if not path.exists():
        return False
    if (descriptor := take_lock(path)) is None:
        return True
    remove_lock(path, descriptor)
    return False


def remove_free_locks(folder: Path) -> None:
    """Remove the locks in this folder that nobody holds."""
    for path in folder.glob("*.lock"):
        with suppress(OSError):  # A lock left behind does no harm.
            if (descriptor := take_lock(path)) is not None:
                remove_lock(path, descriptor)


class SlotTaken(Exception):
    """Another process still uses the device."""


def slot_names(device: str, worker_pid: int, dev: Path = DEV) -> tuple[str, ...]:
    """The lock names of a worker's device, one per GPU; equal for all workers that share this data folder.

    A GPU has one lock per machine; each CPU worker has its own. Containers on one machine may have different
    host names, and machines may share a folder, so the kernel's boot id names the machine. GPU 0 of a
    container need not be the host's first, but its device file has the host's number. Process ids start again
    in each container, so the number of their namespace is added.

    Raises Misconfigured if a GPU is missing.
    """
    if device == "cpu":
        return (f"cpu-{_machine()}-{_pid_namespace()}{worker_pid}",)
    return tuple(f"gpu-{_machine()}-{file}" for file in gpu_files(device, dev))


@contextmanager
def slots(
    paths: Iterable[Path], timeout_s: float, called_off: Callable[[], bool] = lambda: False
) -> Generator[tuple[int, ...]]:
    """Several locks at once, each as from `slot`; `timeout_s` is for all together.

    They are always taken in the order of their names: if two workers took the same locks in different
    orders, each could wait for the other.
    """
    deadline = time.monotonic() + timeout_s
    with ExitStack() as held:
        yield tuple(
            held.enter_context(slot(path, deadline - time.monotonic(), called_off)) for path in sorted(paths)
        )


@contextmanager
def slot(path: Path, timeout_s: float, called_off: Callable[[], bool] = lambda: False) -> Generator[int]:
    """The lock's file descriptor, to be inherited by the process that uses the device.

    Waits up to `timeout_s` for an earlier user to end, then raises SlotTaken; raises CalledOff as soon as
    `called_off` is true. The lock belongs to the open file, not to us: while a process that inherited it
    lives, nobody else gets the lock. At the end, all locks that nobody holds are removed, also those of
    workers long gone.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _wait_for(path, time.monotonic() + timeout_s, called_off)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
        remove_free_locks(path.parent)


def _wait_for(path: Path, deadline: float, called_off: Callable[[], bool], *, shared: bool = False) -> int:
    while (descriptor := take_lock(path, shared=shared)) is None:
        if time.monotonic() > deadline:
            raise SlotTaken(f"Another process still uses the device; it holds {path}.")
        pause(0.1, called_off)  # flock has no timeout.
    return descriptor


def _machine() -> str:
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return socket.gethostname()


def _pid_namespace() -> str:
    try:
        return f"{_PID_NAMESPACE.stat().st_ino}-"
    except OSError:
        return ""
