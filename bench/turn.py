"""One at a time on the card: runs that are compiled side by side are timed one after the other."""

import fcntl
import os
from pathlib import Path
from types import TracebackType

# Names a file; who holds its lock may time something. Without it nobody waits for anybody.
TURN = "BENCH_TURN"


class Turn:
    """The right to be timed, among the processes that are given the same file; its end gives it back."""

    def __init__(self) -> None:
        self._path = os.environ.get(TURN)
        self._lock: int | None = None

    def take(self) -> None:
        """Wait until no other process has it; nothing if this one has."""
        if self._path and self._lock is None:
            Path(self._path).parent.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self._path, os.O_CREAT | os.O_RDWR)
            fcntl.flock(self._lock, fcntl.LOCK_EX)

    def give(self) -> None:
        """Let the next one in; nothing if this one has not got it."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> None:
        self.take()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.give()
