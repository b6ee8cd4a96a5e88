"""Whether this worker has to go."""

import time


class Draining:
    """A plain flag, because a signal handler sets it.

    threading.Event takes a lock to be set and to be waited for. A handler runs in the middle of whatever
    the main thread does: in the wrong moment that is such a wait, or another handler, and the thread would
    wait for ever for a lock that it holds itself.
    """

    def __init__(self) -> None:
        self._asked_at: float | None = None

    def set(self, *_: object) -> None:
        """Also as a signal handler."""
        if self._asked_at is None:
            self._asked_at = time.monotonic()

    def is_set(self) -> bool:
        return self._asked_at is not None

    def for_s(self) -> float:
        """For how many seconds it has been set; 0 where it is not."""
        return 0.0 if self._asked_at is None else time.monotonic() - self._asked_at
