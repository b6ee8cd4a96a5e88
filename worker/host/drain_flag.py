"""Whether this worker must shut down."""

import time


class Draining:
    """A plain flag, because a signal handler sets it.

    threading.Event takes a lock both to set it and to wait for it. A handler may interrupt the main thread
    inside such a wait, or inside another handler; the thread would then wait for ever for a lock that it
    holds itself.
    """

    def __init__(self) -> None:
        self._asked_at: float | None = None

    def set(self, *_: object) -> None:
        """Also usable as a signal handler."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()

    def is_set(self) -> bool:
        return self._asked_at is not None

    def for_s(self) -> float:
        """For how many seconds it has been set; 0 if it is not."""
        return 0.0 if self._asked_at is None else time.monotonic() - self._asked_at
