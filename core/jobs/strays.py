"""Messages that the queue keeps, and nobody waits for."""

from collections.abc import Set

from core.jobs.queue import JobQueue


class Strays:
    """Drops what was a stray at two looks: at one, a worker may be just taking it."""

    def __init__(self, queue: JobQueue) -> None:
        self._queue = queue
        self._seen: Set[str] = frozenset()

    def look(self) -> int:
        """How many were dropped. Raises RecordsUnavailable."""
        found = self._queue.strays()
        dropped = found & self._seen
        if dropped:
            self._queue.drop(dropped)
        self._seen = found - dropped
        return len(dropped)
