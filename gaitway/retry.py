"""How a request is repeated."""

import random
from dataclasses import dataclass

from gaitway.errors import ApiError


@dataclass(frozen=True)
class Retry:
    """How a call is repeated. Waits double from `first_delay_s`; a Retry-After is respected.

    patience_s: how long a follower (`wait`, `events`, `download`) waits for an unavailable service.
    """

    attempts: int = 4
    first_delay_s: float = 0.2
    max_delay_s: float = 10.0
    patience_s: float = 120.0

    def delay_s(self, failures: int, error: Exception | None = None) -> float:
        """Seconds to wait after this many failures in a row."""
        if isinstance(error, ApiError) and error.retry_after_s is not None:
            return min(error.retry_after_s, self.max_delay_s)
        # Jitter, so that many clients do not retry in step.
        doubled_s = self.first_delay_s * 2 ** min(failures - 1, 20)
        return min(doubled_s, self.max_delay_s) * random.uniform(0.75, 1.0)  # noqa: S311
