"""The database's clock, without a round trip for every reading."""

import time
from collections.abc import Callable
from datetime import datetime, timedelta

# An answer that took longer is too old to extrapolate from.
_PROMPT_S = 0.05


class Clock:
    """Asks the database now and then, and extrapolates from its answer; thread-safe.

    ask: returns the database's time. max_age: how long an answer is used; a step of the database's clock is
    noticed after that time at the latest.
    """

    def __init__(self, ask: Callable[[], datetime], max_age: timedelta) -> None:
        self._ask = ask
        self._max_age = max_age
        # The answer and when it came, replaced together.
        self._answer: tuple[datetime, float] | None = None

    def now(self) -> datetime:
        """Raises what `ask` raises."""
        answer = self._answer
        if answer is not None and (passed := timedelta(seconds=time.monotonic() - answer[1])) < self._max_age:
            return answer[0] + passed
        asked_at = time.monotonic()
        said = self._ask()
        answered_at = time.monotonic()
        self._answer = (said, answered_at) if answered_at - asked_at < _PROMPT_S else None
        return said
