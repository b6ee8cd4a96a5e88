"""Lock files that the kernel releases when their holder ends, however it ends."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path


def take(path: Path) -> int | None:
    """The descriptor of this file, locked; None if another process holds it or has just removed it.

    A process that inherits the descriptor holds the lock, too.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    with suppress(BlockingIOError, FileNotFoundError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), path.stat()):
            return descriptor
    os.close(descriptor)
    return None


def remove(path: Path, descriptor: int) -> None:
    """Release a lock that nobody else holds, and remove its file."""
    path.unlink(missing_ok=True)
    os.close(descriptor)


def remove_free(folder: Path) -> None:
    """Remove the locks in this folder that nobody holds."""
    for path in folder.glob("*.lock"):
        with suppress(OSError):  # A lock left behind does no harm.
            if (descriptor := take(path)) is not None:
                remove(path, descriptor)
