"""HTTP for the client: problems become exceptions, temporary failures are retried."""

import random
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx

from gaitway.errors import ApiError, Unavailable, Unreachable, problem_of

Params = Mapping[str, Any]


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


class Transport:
    """One connection pool to one service. Every call it makes may be repeated safely."""

    def __init__(
        self, base_url: str, retry: Retry, timeout_s: float, http: httpx.Client | None = None
    ) -> None:
        self.base_url = base_url.rstrip("/")
        self.retry = retry
        self.timeout = httpx.Timeout(timeout_s, connect=min(timeout_s, 5.0))
        # A proxy from the environment does not reach services on this machine.
        is_here = httpx.URL(self.base_url).host in ("127.0.0.1", "localhost", "::1")
        self._http = http or httpx.Client(
            base_url=self.base_url, timeout=self.timeout, follow_redirects=True, trust_env=not is_here
        )

    def close(self) -> None:
        self._http.close()

    def request(
        self,
        method: str,
        path: str,
        *,
        params: Params | None = None,
        json: Any = None,
        content: bytes | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> httpx.Response:
        """The whole answer. Raises ApiError, and Unreachable when no try got an answer."""
        for failures in range(1, self.retry.attempts + 1):
            try:
                with _reachable(self.base_url):
                    response = self._http.request(
                        method, path, params=params, json=json, content=content, headers=headers
                    )
                # A retried DELETE may find that the first one has worked although its answer was lost.
                if response.is_success or (
                    method == "DELETE" and failures > 1 and response.status_code == 404
                ):
                    return response
                raise problem_of(response)
            except (Unreachable, Unavailable) as error:
                if failures == self.retry.attempts:
                    raise
                time.sleep(self.retry.delay_s(failures, error))
        raise AssertionError("a Retry needs at least one attempt")

    @contextmanager
    def stream(
        self,
        path: str,
        *,
        params: Params | None = None,
        headers: Mapping[str, str] | None = None,
        read_timeout_s: float | None = None,
    ) -> Generator[httpx.Response]:
        """One try at an answer, read as it arrives. Raises ApiError, and Unreachable, also in mid-body."""
        seconds = self.timeout.as_dict()
        timeout = httpx.Timeout(**{**seconds, "read": read_timeout_s or seconds["read"]})
        request = self._http.build_request("GET", path, params=params, headers=headers, timeout=timeout)
        with _reachable(self.base_url):
            response = self._http.send(request, stream=True)
            try:
                if not response.is_success and response.status_code != 304:
                    response.read()
                    raise problem_of(response)
                yield response
            finally:
                response.close()


@contextmanager
def _reachable(url: str) -> Generator[None]:
    try:
        yield
    except (httpx.TransportError, httpx.StreamError) as error:
        raise Unreachable(url, str(error) or type(error).__name__) from error
    except (httpx.InvalidURL, httpx.TooManyRedirects, httpx.DecodingError) as error:
        raise Unreachable(url, str(error)) from error
