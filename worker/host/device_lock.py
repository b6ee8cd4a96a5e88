"""One device, one job: a lock that is held by whoever uses the device, even when its supervisor is gone.

A job on several GPUs holds the locks of all of them.
"""

import os
import socket
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, contextmanager
from pathlib import Path

from core.retry import pause
from worker.host import file_lock
from worker.host.device import DEV, gpu_files

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_PID_NAMESPACE = Path("/proc/self/ns/pid")


class SlotTaken(Exception):
    """Another process still uses the device."""


def slot_names(device: str, worker_pid: int, dev: Path = DEV) -> tuple[str, ...]:
    """What a worker's device, or each of its GPUs, is called by everybody who may share this data folder.

    A GPU is one slot for its machine, a CPU worker is one by itself. Containers of one machine may all be
    called otherwise, and machines may share a folder: the kernel's boot tells machines apart. GPU 0 of a
    container need not be the host's first, but its device file has the host's number; and process ids
    begin anew in each container, but not the numbers of what they are counted in.

    Raises Misconfigured where a GPU is not there.
    """
    if device == "cpu":
        return (f"cpu-{_machine()}-{_pid_namespace()}{worker_pid}",)
    return tuple(f"gpu-{_machine()}-{file}" for file in gpu_files(device, dev))


@contextmanager
def slots(
    paths: Iterable[Path], patience_s: float, called_off: Callable[[], bool] = lambda: False
) -> Generator[tuple[int, ...]]:
    """Several slots at once, as `slot` gives one; `patience_s` is for all together.

    They are taken in the order of their names, whoever takes them: were two to take the same ones in
    different orders, each could wait for what the other has.
    """
    deadline = time.monotonic() + patience_s
    with ExitStack() as held:
        yield tuple(
            held.enter_context(slot(path, deadline - time.monotonic(), called_off)) for path in sorted(paths)
        )


@contextmanager
def slot(path: Path, patience_s: float, called_off: Callable[[], bool] = lambda: False) -> Generator[int]:
    """The lock's file descriptor, to be inherited by the process that uses the device.

    Waits up to `patience_s` for an earlier user to die; raises SlotTaken after that, and CalledOff as
    soon as that is so meanwhile. The lock belongs to the open file, not to us: as long as an inheritor
    lives, nobody else gets it. Locks that nobody holds any more, also those of workers long gone, are
    removed at the end.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _wait_for(path, time.monotonic() + patience_s, called_off)
    try:
        yield descriptor
    finally:
        os.close(descriptor)
        file_lock.remove_free(path.parent)


def _wait_for(path: Path, deadline: float, called_off: Callable[[], bool]) -> int:
    while (descriptor := file_lock.take(path)) is None:
        if time.monotonic() > deadline:
            raise SlotTaken(f"Another process still uses the device; it holds {path}.")
        pause(0.1, called_off)  # flock has no wait with a time limit.
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
