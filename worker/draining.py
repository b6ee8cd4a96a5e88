"""Whether this worker has to go."""


class Draining:
    """A plain flag, because a signal handler sets it.

    threading.Event takes a lock to be set and to be waited for. A handler runs in the middle of whatever
    the main thread does: in the wrong moment that is such a wait, or another handler, and the thread would
    wait for ever for a lock that it holds itself.
    """

    def __init__(self) -> None:
        self._asked = False

    def set(self, *_: object) -> None:
        """Also as a signal handler."""
        self._asked = True

    def is_set(self) -> bool:
        return self._asked
