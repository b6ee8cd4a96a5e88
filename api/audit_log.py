"""The audit log of requests: entries are gathered for a tenth of a second, and written together."""

from collections.abc import Callable, Sequence
from threading import Lock, Timer

import structlog

from core.accounts.store import Actor, AuditEntry
from core.errors import RecordsUnavailable
from core.jobs.job import utc_now

log = structlog.get_logger()
_GATHER_S = 0.1
_PAUSE_IN_OUTAGE_S = 1.0
# An outage of the record holds back so many entries; then the oldest are dropped, and the log says so.
_MOST_HELD = 10_000


class AuditLog:
    """Writes what is added within a tenth of a second, in an outage once it is over; thread-safe.

    A process that is killed in that time loses the entry. Changes of accounts write theirs in their own
    transaction, and a job has its owner.
    """

    def __init__(self, write: Callable[[Sequence[AuditEntry]], None]) -> None:
        self._write = write
        self._held: list[AuditEntry] = []
        self._lock = Lock()
        self._writing = Lock()

    def add(self, actor: Actor, action: str, about: str) -> None:
        """about: the kind and the id of the thing."""
        entry = AuditEntry(
            at=utc_now(),
            user=actor.user,
            token=actor.token,
            action=action,
            object=about,
            address=actor.address,
            correlation_id=actor.correlation_id,
        )
        with self._lock:
            self._held.append(entry)
            is_first = len(self._held) == 1
        if is_first:
            self._flush_after(_GATHER_S)

    def flush(self) -> None:
        """Write what is held."""
        with self._writing:
            with self._lock:
                held, self._held = self._held, []
            try:
                self._write(held)
            except RecordsUnavailable as error:
                log.warning("audit_waits", entries=len(held), error=error.detail)
                self._hold_again(held)

    def _hold_again(self, entries: list[AuditEntry]) -> None:
        with self._lock:
            kept = [*entries, *self._held]
            if (lost := len(kept) - _MOST_HELD) > 0:
                log.error("audit_dropped", entries=lost)
            self._held = kept[-_MOST_HELD:]
        self._flush_after(_PAUSE_IN_OUTAGE_S)

    def _flush_after(self, seconds: float) -> None:
        timer = Timer(seconds, self.flush)
        timer.daemon = True
        timer.start()
