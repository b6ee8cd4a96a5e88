"""Timing one at a time on a card: runs that compile side by side are timed one after another."""

import fcntl
import os
from pathlib import Path
from types import TracebackType

# Names a file; the process that holds its lock may time its work. If unset, nobody waits.
TURN = "BENCH_TURN"


class Turn:
    """The right to be timed among processes with the same file; it is released when the process ends."""

    def __init__(self) -> None:
        self._path = os.environ.get(TURN)
        self._lock: int | None = None

    def take(self) -> None:
        """Wait until no other process has it; return at once if this one has."""
        if self._path and self._lock is None:
            Path(self._path).parent.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self._path, os.O_CREAT | os.O_RDWR)
            fcntl.flock(self._lock, fcntl.LOCK_EX)

    def give(self) -> None:
        """Release it; do nothing if this process does not have it."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> None:
        self.take()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.give()
