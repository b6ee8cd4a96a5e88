"""How a call asks the service, and what several calls share."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel

from gaitway.retry import Retry, request
from gaitway.steps import Call, Feed, Found, Request
from gaitway.views import JobView, Page

AnyView = TypeVar("AnyView", bound=BaseModel)

POLL_S = 0.5
_PAGE = 100


@dataclass(frozen=True)
class Asking:
    """Asks one service."""

    base_url: str
    retry: Retry

    def get(self, job_id: str) -> Call[JobView]:
        return self._job(Request("GET", job_path(job_id)))

    def _ask(self, method: str, path: str, **more: Any) -> Call[httpx.Response]:
        return request(self.retry, Request(method, path, **more))

    def _job(self, asked: Request) -> Call[JobView]:
        response = yield from request(self.retry, asked)
        return JobView.model_validate_json(response.content).of(self.base_url)

    def _items(self, path: str, view: type[AnyView]) -> Call[Sequence[AnyView]]:
        answer = yield from self._ask("GET", path)
        return [view.model_validate(item) for item in answer.json()["items"]]

    def _all(
        self, path: str, view: type[AnyView], limit: int | None, filters: Mapping[str, Any] | None = None
    ) -> Feed:
        """The items of a listing, page by page, at most `limit`."""

        def page(cursor: str | None, number: int) -> Call[Page[AnyView]]:
            asked = {**(filters or {}), "limit": number} | ({"cursor": cursor} if cursor else {})
            answer = yield from self._ask("GET", path, params=asked)
            found = answer.json()
            return Page(items=[view.model_validate(item) for item in found["items"]], next=found.get("next"))

        return paged(limit, page)

    def _has_ended(self, job_id: str) -> Call[bool]:
        return (yield from self.get(job_id)).is_final


def paged(limit: int | None, page: Callable[[str | None, int], Call[Page[Any]]]) -> Feed:
    """The items of one page after the other, at most `limit`. page: of a cursor, with a largest number."""
    cursor, left = None, limit
    while left is None or left > 0:
        found = yield from page(cursor, min(left or _PAGE, _PAGE))
        for item in found.items:
            yield Found(item)
        left = None if left is None else left - len(found)
        cursor = found.next
        if cursor is None:
            return


def job_path(job_id: str, *parts: str) -> str:
    # Quoted, so that an id or a name with a slash or dots cannot become another address.
    return "/".join(["/jobs", *(quote(part, safe="") for part in (job_id, *parts))])
