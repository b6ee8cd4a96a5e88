"""Limits what a process may write into its job's log, so that a flood fills no disk."""

import time
from collections.abc import Callable, Iterator

# Bytes per second in the long run, and bytes at once. A chatty trainer writes a few hundred bytes a second.
_RATE, _BURST = 64 * 1024, 4 * 2**20
# Lines that may wait for an unavailable store.
_MAX_WAITING = 20_000


class LogLimit:
    """Passes lines on while the budget lasts, and says how many it left out. clock: seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._budget = float(_BURST)
        self._at = clock()
        self._num_left_out = 0
        self._why = ""

    def pass_on(self, line: str, num_waiting: int = 0) -> Iterator[str]:
        """The line, after a note on those left out before it; nothing if it is left out itself.

        num_waiting: how many lines are not stored yet.
        """
        now = self._clock()
        self._budget = min(_BURST, self._budget + _RATE * (now - self._at))
        self._at = now
        size = len(line) + 1
        # After a flood the log resumes only when there is room for more than one line.
        floor = _RATE if self._num_left_out else 0
        if self._budget < size + floor:
            self._leave_out(f"the process printed more than {_RATE // 1024} kB/s")
        elif num_waiting > _MAX_WAITING:
            self._leave_out(f"{_MAX_WAITING} waited for PostgreSQL or the object store")
        else:
            self._budget -= size
            yield from self.end()
            yield line

    def end(self) -> Iterator[str]:
        """A note on lines that were left out, if there were any."""
        if self._num_left_out:
            yield f"[{self._num_left_out} lines left out: {self._why}]"
            self._num_left_out = 0

    def _leave_out(self, why: str) -> None:
        self._why = self._why if self._num_left_out else why
        self._num_left_out += 1
