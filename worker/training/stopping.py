"""The supervisor's signals to the training process, and what they have asked for."""

import os
import signal
from collections.abc import Generator
from contextlib import contextmanager

from worker.stop_signals import DRAIN_SIGNAL, STOP_SIGNAL


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
