"""Watches a training process.

The lease of its job is renewed while it runs, and a cancellation is noticed, or that it must make room. A
process that hangs is noticed, too: it is silent for far longer than ever before, or was stopped. What it
writes into the log is limited, so that a flood fills no disk.
"""

import threading
import time
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from typing import Self

import structlog

from core.errors import LeaseLost, Unavailable
from core.jobs.attempts import Claim
from core.jobs.status import JobStatus
from core.settings import WorkerSettings
from worker.host.processes import processes
from worker.stopping import Draining

log = structlog.get_logger()
# It is ended after many times its own longest silence: rendering on a busy machine may take minutes.
_TIMES_THE_LONGEST = 20.0
# Until it has shown how long its updates take, it may trace and compile a large body.
_FIRST_S = 3600.0
# A debugger stops a process for a moment.
_STOPPED_S = 20.0
_CHECK_EVERY_S = 1.0
_PROC = Path("/proc")
# Bytes per second in the long run, and bytes at once. A chatty trainer writes a few hundred bytes a second.
_RATE, _BURST = 64 * 1024, 4 * 2**20
# Lines that may wait for an unavailable store.
_MAX_WAITING = 20_000


class Heartbeat:
    """A thread that renews the lease. It waits out an outage of the store; then the token decides.

    draining: set once the attempt must make room for another job. after_beat: called after each renewal.
    """

    def __init__(
        self,
        claim: Claim,
        settings: WorkerSettings,
        draining: Draining,
        after_beat: Callable[[], None] = lambda: None,
    ) -> None:
        self.cancelled = threading.Event()
        self.lost = threading.Event()
        self._claim = claim
        self._settings = settings
        self._draining = draining
        self._after_beat = after_beat
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _beat(self) -> None:
        while not self._over.is_set() and not self.lost.is_set():
            try:
                found = self._claim.store.renew(self._claim.job_id, self._claim.token, self._settings.lease)
            except Unavailable as error:
                log.warning("heartbeat_missed", error=error.detail)
            except LeaseLost:
                self.lost.set()
            except Exception as error:  # A bug of ours must not cost the job its lease.
                log.error("heartbeat_failed", error=repr(error))
            else:
                if found.status == JobStatus.CANCELLING:
                    self.cancelled.set()
                elif found.room_for is not None:
                    self._draining.make_room(found.room_for)
                self._after_beat()
            self._over.wait(self._settings.heartbeat.total_seconds())


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
