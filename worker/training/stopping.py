"""What the supervisor's signals have asked of the training process."""

import os
import signal
from collections.abc import Generator
from contextlib import contextmanager

from worker.stop_signals import DRAIN_SIGNAL, STOP_SIGNAL


class Stopping:
    """asked: to end after the epoch in progress. leaving: because the job goes on elsewhere.

    As long as nothing would be lost, DRAIN_SIGNAL has its default action: it ends the process at once, also
    in the middle of a compilation or of a video, and with the process its render process.

    A signal that comes in the very moment of a switch may be lost, and no mask holds it back: it would go
    to one of the numerical stack's threads. That is why the supervisor says DRAIN_SIGNAL again and again.
    """

    def __init__(self) -> None:
        self.asked = False
        self.leaving = False
        signal.signal(STOP_SIGNAL, self._note)
        signal.signal(DRAIN_SIGNAL, signal.SIG_DFL)

    def keep_before_leaving(self) -> None:
        """From now on there is something to keep: who says DRAIN_SIGNAL waits for it."""
        signal.signal(DRAIN_SIGNAL, self._note)

    @contextmanager
    def nothing_to_keep(self) -> Generator[None]:
        """Inside, all that there is has been handed over."""
        signal.signal(DRAIN_SIGNAL, signal.SIG_DFL)
        if self.leaving:  # It was said a moment before.
            os.kill(os.getpid(), DRAIN_SIGNAL)
        try:
            yield
        finally:
            self.keep_before_leaving()

    def _note(self, number: int, _: object) -> None:
        self.asked = True
        self.leaving |= number == DRAIN_SIGNAL
