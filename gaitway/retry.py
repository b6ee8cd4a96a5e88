"""How calls are repeated."""

import random
from dataclasses import dataclass

import httpx

from gaitway.errors import ApiError, Unavailable, Unreachable, problem_of
from gaitway.steps import Call, Request, Send, Sleep


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


def request(retry: Retry, asked: Request) -> Call[httpx.Response]:
    """The whole answer to a request that may be repeated. Raises ApiError, and Unreachable when no try got an
    answer."""
    for failures in range(1, retry.attempts + 1):
        try:
            response: httpx.Response = yield Send(asked)
            # A retried DELETE may find that the first one has worked although its answer was lost.
            worked_before = asked.method == "DELETE" and failures > 1 and response.status_code == 404
            if response.is_success or worked_before:
                return response
            raise problem_of(response)
        except (Unreachable, Unavailable) as error:
            if failures == retry.attempts:
                raise
            yield Sleep(retry.delay_s(failures, error))
    raise AssertionError("a Retry needs at least one attempt")
