"""The database's clock, without a round trip for each look at it."""

import time
from collections.abc import Callable
from datetime import datetime, timedelta

# A slower answer is old when it comes: nothing is counted on from it.
_PROMPT_S = 0.05


class Clock:
    """Asks the database once in a while, and counts on from its answer; thread-safe.

    ask: the database's time. max_age: how long an answer is counted on from; after that time at the latest, a
    step of the database's clock is noticed.
    """

    def __init__(self, ask: Callable[[], datetime], max_age: timedelta) -> None:
        self._ask = ask
        self._max_age = max_age
        # The answer and when it came, replaced together.
        self._answer: tuple[datetime, float] | None = None

    def now(self) -> datetime:
        """Raises what `ask` raises, where it has to be asked."""
        answer = self._answer
        if answer is not None and (passed := timedelta(seconds=time.monotonic() - answer[1])) < self._max_age:
            return answer[0] + passed
        asked_at = time.monotonic()
        said = self._ask()
        answered_at = time.monotonic()
        self._answer = (said, answered_at) if answered_at - asked_at < _PROMPT_S else None
        return said
