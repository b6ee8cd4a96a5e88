# Made by .ci/make_client.py: change gaitway/async_client/__init__.py instead.
"""The client of a service; `.ci/make_client.py` makes `gaitway.client` from `gaitway.async_client`."""

from functools import partial
from types import TracebackType
from typing import Any, Self

import httpx

from gaitway.addresses import address
from gaitway.client.accounts import Accounts
from gaitway.client.files import Files
from gaitway.client.jobs import Job
from gaitway.client.retention import Retention
from gaitway.client.sweeps import Sweeps
from gaitway.client.webhooks import Webhooks
from gaitway.credentials import token_for
from gaitway.retry import Retry

__all__ = ["Client", "Job"]


class Client(Files, Sweeps, Accounts, Retention, Webhooks):
    """Talks to one service. Usable as a context manager; `Client` also from several threads.

    `AsyncClient` has the methods of `Client`, awaited; `list`, `sweeps`, `models`, `workers`, `events` and
    `logs` are read with `async for`.
    base_url: by default that of GAITWAY_URL, otherwise http://127.0.0.1:8000. token: for a service with
    accounts; by default that of GAITWAY_TOKEN, or the one that `gaitway login` has stored for this address.
    http: an httpx client.
    Every method raises ApiError for a refusal (NotFound, Conflict, Rejected, Unavailable), and
    Unreachable when nothing answers. Temporary failures are retried first; a retry never has an
    effect twice, not even that of `submit`. An address without http:// is a WrongAddress.
    """

    def __init__(
        self,
        base_url: str | None = None,
        *,
        token: str | None = None,
        timeout_s: float = 30.0,
        retry: Retry | None = None,
        http: httpx.Client | None = None,
    ) -> None:
        url = address(base_url)
        super().__init__(url, token or token_for(url), timeout_s, retry or Retry(), http)

    @property
    def base_url(self) -> str:
        return self._base_url

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy, also one in another process, has connections of its own."""
        facts = {"token": self._token, "timeout_s": self._timeout_s, "retry": self._retry}
        return partial(type(self), self.base_url, **facts), ()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.base_url!r})"
