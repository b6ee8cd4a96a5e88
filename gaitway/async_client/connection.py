"""Requests to a service: repeated where that helps, with refusals raised as errors."""

from collections.abc import AsyncGenerator, AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

import httpx

from gaitway.addresses import ID_LENGTH, SEARCHED, http_options, path_of, the_one
from gaitway.concurrency import async_pieces, async_sleep
from gaitway.errors import NotFound, Unavailable, Unreachable, is_refusal, problem_of, reachable
from gaitway.retry import Retry
from gaitway.schema import View
from gaitway.views import Page

AnyView = TypeVar("AnyView", bound=View)

_PAGE = 100


class AsyncConnection:
    """One connection pool to one service. Usable as a context manager."""

    def __init__(
        self, base_url: str, token: str | None, timeout_s: float, retry: Retry, http: httpx.AsyncClient | None
    ) -> None:
        self._base_url, self._timeout_s, self._retry = base_url, timeout_s, retry
        self._token = token
        self._credentials = {} if token is None else {"Authorization": f"Bearer {token}"}
        self._http = http or httpx.AsyncClient(**http_options(base_url))

    async def _request(
        self,
        method: str,
        path: str,
        *,
        file: Path | None = None,
        read_timeout_s: float | None = None,
        headers: Mapping[str, str] | None = None,
        once: bool = False,
        **content: Any,
    ) -> httpx.Response:
        """The whole answer. file: sent in pieces. read_timeout_s: by default the client's. once: no retry.

        Temporary failures are retried. Raises ApiError, and Unreachable when no attempt got an answer.
        """
        for failures in range(1, self._retry.attempts + 1):
            if file is not None:
                content["content"] = async_pieces(file)
                headers = {**(headers or {}), "Content-Length": str(file.stat().st_size)}
            try:
                with reachable(self._base_url):
                    response = await self._http.request(
                        method,
                        path,
                        headers={**self._credentials, **(headers or {})},
                        timeout=self._timeout(read_timeout_s),
                        **content,
                    )
                # A retried DELETE may find that the first one has worked although its answer was lost.
                worked_before = method == "DELETE" and failures > 1 and response.status_code == 404
                if response.is_success or worked_before:
                    return response
                raise problem_of(response)
            except (Unreachable, Unavailable) as error:
                if once or failures == self._retry.attempts:
                    raise
                await async_sleep(self._retry.delay_s(failures, error))
        raise AssertionError("a Retry needs at least one attempt")

    @asynccontextmanager
    async def _opened(
        self,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        params: Mapping[str, Any] | None = None,
        read_timeout_s: float | None = None,
    ) -> AsyncGenerator[httpx.Response]:
        """An answer whose body is read in pieces. Raises ApiError; and Unreachable, also while it is read."""
        timeout, headers = self._timeout(read_timeout_s), {**self._credentials, **(headers or {})}
        with reachable(self._base_url):
            async with self._http.stream(
                "GET", path, headers=headers, params=params, timeout=timeout
            ) as response:
                if is_refusal(response):
                    await response.aread()
                    raise problem_of(response)
                yield response

    def _timeout(self, read_timeout_s: float | None) -> httpx.Timeout:
        longest_s = self._timeout_s
        return httpx.Timeout(longest_s, connect=min(longest_s, 5.0), read=read_timeout_s or longest_s)

    async def _get(self, path: str, view: type[AnyView], **content: Any) -> AnyView:
        response = await self._request("GET", path, **content)
        return view.model_validate_json(response.content, context=self)

    async def _post(self, path: str, view: type[AnyView], **content: Any) -> AnyView:
        response = await self._request("POST", path, **content)
        return view.model_validate_json(response.content, context=self)

    async def _items(self, path: str, view: type[AnyView], **content: Any) -> Sequence[AnyView]:
        answer = await self._request("GET", path, **content)
        return [view.model_validate(item, context=self) for item in answer.json()["items"]]

    async def _page(
        self, path: str, view: type[AnyView], cursor: str | None, limit: int, filters: Mapping[str, Any]
    ) -> Page[AnyView]:
        params = {**filters, "limit": limit} | ({"cursor": cursor} if cursor else {})
        answer = (await self._request("GET", path, params=params)).json()
        items = [view.model_validate(item, context=self) for item in answer["items"]]
        return Page(items=items, next=answer.get("next"), of_newest=answer.get("of_newest"))

    async def _all(
        self, path: str, view: type[AnyView], limit: int | None, filters: Mapping[str, Any]
    ) -> AsyncIterator[AnyView]:
        """The items of a listing, page by page, at most `limit`."""
        cursor, left = None, limit
        while left is None or left > 0:
            page = await self._page(path, view, cursor, min(left or _PAGE, _PAGE), filters)
            for item in page.items:
                yield item
            left = None if left is None else left - len(page)
            cursor = page.next
            if cursor is None:
                return

    async def _job_path(self, job_id: str, *parts: str) -> str:
        """job_id: an id, a beginning or an end of one, or `last`."""
        return path_of("jobs", await self._full_id(job_id), *parts)

    async def _full_id(self, name: str) -> str:
        if len(name) == ID_LENGTH or not name.replace("-", "").isalnum():
            return name
        limit = 1 if name == "last" else SEARCHED
        ids = [job.id async for job in self._all("/jobs", _Named, limit, {})]
        try:
            return the_one(name, ids, "job")
        except LookupError as error:
            raise NotFound(404, {"detail": str(error)}) from None


class _Named(View):
    id: str
