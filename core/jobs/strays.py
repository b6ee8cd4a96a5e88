"""Removes messages that the queue keeps although nobody waits for them."""

from collections.abc import Set

from core.jobs.queue import JobQueue


class StrayMessages:
    """Drops what was a stray at two reads of the queue: during one, a worker may just be taking it."""

    def __init__(self, queue: JobQueue) -> None:
        self._queue = queue
        self._seen: Set[str] = frozenset()

    def look(self) -> int:
        """Returns how many were dropped. Raises RecordsUnavailable."""
        found = self._queue.strays()
        dropped = found & self._seen
        if dropped:
            self._queue.drop(dropped)
        self._seen = found - dropped
        return len(dropped)
