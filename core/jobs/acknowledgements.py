"""Removes dispatches that RQ has received from the record, several in one round trip."""

from collections.abc import Callable, Sequence
from threading import Lock, Timer

import structlog

from core.errors import RecordsUnavailable
from core.jobs.store import Dispatch

log = structlog.get_logger()

_GATHER_S = 0.1


class Acknowledgements:
    """Gathers dispatches for a tenth of a second and writes them in one call; thread-safe.

    write: `JobStore.dispatched`. A dispatch that a crash or an outage leaves in the record does no harm: the
    reconciler hands it over again, and RQ already knows it.
    """

    def __init__(self, write: Callable[[Sequence[Dispatch]], None]) -> None:
        self._write = write
        self._gathered: list[Dispatch] = []
        self._lock = Lock()
        self._writing = Lock()

    def add(self, dispatch: Dispatch) -> None:
        with self._lock:
            self._gathered.append(dispatch)
            is_first = len(self._gathered) == 1
        if is_first:
            timer = Timer(_GATHER_S, self.flush)
            timer.daemon = True
            timer.start()

    def flush(self) -> None:
        """Write what has been gathered; a write that is under way elsewhere has ended, too."""
        with self._writing:
            with self._lock:
                gathered, self._gathered = self._gathered, []
            self._write_or_drop(gathered)

    def add_at_once(self, dispatch: Dispatch) -> None:
        """Write this one now."""
        self._write_or_drop([dispatch])

    def _write_or_drop(self, dispatches: Sequence[Dispatch]) -> None:
        try:
            self._write(dispatches)
        except RecordsUnavailable as error:
            log.warning("acknowledgements_dropped", number=len(dispatches), error=error.detail)
