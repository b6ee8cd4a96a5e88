"""One device, one job: a lock that is held by whoever uses the device, even when its supervisor is gone."""

import fcntl
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


class SlotTaken(Exception):
    """Another process still uses the device."""


@contextmanager
def slot(path: Path, patience_s: float) -> Generator[int]:
    """The lock's file descriptor, to be inherited by the process that uses the device.

    Waits up to `patience_s` for an earlier user to die; raises SlotTaken after that. The lock belongs to
    the open file, not to us: as long as an inheritor lives, nobody else gets it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        _lock(descriptor, path, time.monotonic() + patience_s)
        yield descriptor
    finally:
        os.close(descriptor)


def _lock(descriptor: int, path: Path, deadline: float) -> None:
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise SlotTaken(f"Another process still uses the device of {path.stem}.") from None
            time.sleep(0.1)  # flock has no wait with a time limit.
        else:
            return
