"""Keeps what is done at checkpoints besides training to a share of the training's time."""

import time
from dataclasses import dataclass


@dataclass
class TimeBudget:
    """Says when another one may be done, by what the last one took.

    The first one also compiles or imports what the end of the job needs as well, so it says nothing about the
    next.
    """

    share: float = 0.03
    _is_prepared: bool = False
    _next_at: float = 0.0

    def allows_another(self) -> bool:
        """Whether the last one's cost has become a small share of the time since then."""
        return time.monotonic() >= self._next_at

    def spent(self, began: float) -> None:
        """Another one is done. began: its start, by `time.monotonic`."""
        now = time.monotonic()
        self._next_at = now + (now - began) / self.share if self._is_prepared else now
        self._is_prepared = True
