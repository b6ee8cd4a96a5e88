"""Whether an attempt must leave its device, and why and by which signals its training process is stopped.

They have a module of their own because the process handles them before it loads anything slow.
"""

import os
import signal
import time
from collections.abc import Generator
from contextlib import contextmanager
from enum import StrEnum

# Finish the epoch, keep the work, make the video of how far it came, and exit.
STOP_SIGNAL = signal.SIGTERM
# The job continues elsewhere: keep a checkpoint, nothing else, and exit; at once if there is nothing new to
# keep. Sent repeatedly until the process ends.
DRAIN_SIGNAL = signal.SIGUSR1


class Stop(StrEnum):
    """The reason for which a training process was asked to stop."""

    CANCEL = "cancel"
    TIMEOUT = "timeout"
    DRAIN = "drain"


class Draining:
    """Whether an attempt must leave: its worker shuts down, or it makes room for another job.

    A plain flag, because a signal handler sets it. room_for: in words, which job; None at a shutdown.

    threading.Event takes a lock both to set it and to wait for it. A handler may interrupt the main thread
    inside such a wait, or inside another handler; the thread would then wait for ever for a lock that it
    holds itself.
    """

    def __init__(self) -> None:
        self._asked_at: float | None = None
        self.room_for: str | None = None

    def make_room(self, room_for: str) -> None:
        """Set it for another job; does nothing if it was set before."""
        if not self.is_set():
            self.room_for = room_for
            self.set()

    def set(self, *_: object) -> None:
        """Also usable as a signal handler."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()

    def is_set(self) -> bool:
        return self._asked_at is not None

    def for_s(self) -> float:
        """For how many seconds it has been set; 0 if it is not."""
        return 0.0 if self._asked_at is None else time.monotonic() - self._asked_at


class StopRequest:
    """asked: to end after the epoch in progress. leaving: because the job continues elsewhere.

    While nothing would be lost, DRAIN_SIGNAL has its default action: it ends the process at once, even during
    a compilation or a video, and its render process with it.

    A signal that comes while the action is being switched may be lost. A mask does not help: the signal would
    go to another thread of the numerical stack. So the supervisor sends DRAIN_SIGNAL repeatedly.
    """

    def __init__(self) -> None:
        self.asked = False
        self.leaving = False
        signal.signal(STOP_SIGNAL, self._note)
        signal.signal(DRAIN_SIGNAL, signal.SIG_DFL)

    def is_the_leaders(self) -> None:
        """The process of another host decides: Slurm sends its signals to all processes of a step."""
        signal.signal(STOP_SIGNAL, signal.SIG_IGN)
        signal.signal(DRAIN_SIGNAL, signal.SIG_IGN)

    def keep_before_leaving(self) -> None:
        """From now on there is something to keep: DRAIN_SIGNAL no longer ends the process at once."""
        signal.signal(DRAIN_SIGNAL, self._note)

    @contextmanager
    def nothing_to_keep(self) -> Generator[None]:
        """Inside the block everything has been handed over: DRAIN_SIGNAL may end the process at once."""
        signal.signal(DRAIN_SIGNAL, signal.SIG_DFL)
        if self.leaving:  # It came just before.
            os.kill(os.getpid(), DRAIN_SIGNAL)
        try:
            yield
        finally:
            self.keep_before_leaving()

    def _note(self, number: int, _: object) -> None:
        self.asked = True
        self.leaving |= number == DRAIN_SIGNAL
