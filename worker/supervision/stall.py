"""Notices that a training process hangs: it is silent for far longer than ever before, or was stopped."""

import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

from worker.host.processes import processes

# It is ended after many times its own longest silence: rendering on a busy machine may take minutes.
_TIMES_THE_LONGEST = 20.0
# Until it has shown how long its updates take, it may trace and compile a large body.
_FIRST_S = 3600.0
# A debugger stops a process for a moment.
_STOPPED_S = 20.0
_CHECK_EVERY_S = 1.0
_PROC = Path("/proc")


class StallWatch:
    """Watches a process group for silence. patience: a silence that is always allowed.

    clock: seconds. stopped: returns the ids of a group's stopped processes.
    """

    def __init__(
        self,
        patience: timedelta,
        clock: Callable[[], float] = time.monotonic,
        stopped: Callable[[int], list[int]] | None = None,
    ) -> None:
        self._patience_s = patience.total_seconds()
        self._clock = clock
        self._stopped = stopped or stopped_processes
        self._heard_at = self._looked_at = clock()
        self._longest_s = 0.0
        self._is_training = False
        self._stopped_since: float | None = None

    def hear(self, *, is_progress: bool = False) -> None:
        """Note a sign of life. is_progress: training has advanced."""
        now = self._clock()
        if self._is_training:
            self._longest_s = max(self._longest_s, now - self._heard_at)
        self._is_training |= is_progress
        self._heard_at = now

    def what_is_wrong(self, group: int) -> str | None:
        """A sentence if the group has hung for too long; looks at most once a second."""
        now = self._clock()
        if now - self._looked_at < _CHECK_EVERY_S:
            return None
        self._looked_at = now
        allowed_s = self._allowed_s()
        if now - self._heard_at >= allowed_s:
            return f"The training process said nothing for {allowed_s:.0f} s and was ended."
        return self._stopped_too_long(self._stopped(group), now)

    def _stopped_too_long(self, stopped: list[int], now: float) -> str | None:
        if not stopped:
            self._stopped_since = None
        elif self._stopped_since is None:
            self._stopped_since = now
        elif now - self._stopped_since >= _STOPPED_S:
            return f"Process {stopped[0]} of the training was stopped by a signal; it was ended."
        return None

    def _allowed_s(self) -> float:
        first_s = 0.0 if self._is_training else _FIRST_S
        return max(first_s, self._patience_s, _TIMES_THE_LONGEST * self._longest_s)


def stopped_processes(group: int, proc: Path = _PROC) -> list[int]:
    """The ids of stopped processes (SIGSTOP, a debugger) in a process group; none if there is no /proc."""
    return sorted(pid for pid, state, its_group in processes(proc) if its_group == group and state in "Tt")


def is_stopped(pid: int, proc: Path = _PROC) -> bool:
    """Whether the process was stopped by a signal."""
    return any(found == pid and state in "Tt" for found, state, _ in processes(proc, str(pid)))
