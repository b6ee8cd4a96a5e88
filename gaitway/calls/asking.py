"""How a call asks the service, and what several calls share."""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel

from gaitway.errors import NotFound
from gaitway.retry import Retry, request
from gaitway.steps import Call, Feed, Found, Request, Step
from gaitway.views import JobView, Page

AnyView = TypeVar("AnyView", bound=BaseModel)

POLL_S = 0.5
_PAGE = 100
ID_LENGTH = 23
# An abbreviated id is looked for among this many jobs.
SEARCHED = 1000

P = ParamSpec("P")
Result = TypeVar("Result")
Told = TypeVar("Told")
Asked = TypeVar("Asked", bound="Asking")


@dataclass(frozen=True)
class Asking:
    """Asks one service."""

    base_url: str
    retry: Retry

    def get(self, job_id: str) -> Call[JobView]:
        full_id = yield from self._full_id(job_id)
        return (yield from self._job(Request("GET", job_path(full_id))))

    def _full_id(self, name: str) -> Call[str]:
        """The id of the job that this names: an id, a beginning or an end of one, or `last`."""
        if len(name) == ID_LENGTH or not name.replace("-", "").isalnum():
            return name
        ids, cursor = list[str](), None
        while len(ids) < SEARCHED:
            limit = 1 if name == "last" else _PAGE
            asked: dict[str, Any] = {"limit": limit} | ({"cursor": cursor} if cursor else {})
            page = (yield from self._ask("GET", "/jobs", params=asked)).json()
            ids += [item["id"] for item in page["items"]]
            cursor = page.get("next")
            if cursor is None or name == "last":
                break
        try:
            return the_one(name, ids, "job")
        except LookupError as error:
            raise NotFound(404, {"detail": str(error)}) from None

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


def of_a_job(
    call: Callable[Concatenate[Asked, str, P], Generator[Told, Any, Result]],
) -> Callable[Concatenate[Asked, str, P], Generator[Told | Step, Any, Result]]:
    """The call; it also takes `last`, and a beginning or an end of an id that fits one job."""

    @wraps(call)
    def named(
        self: Asked, job_id: str, /, *more: P.args, **also: P.kwargs
    ) -> Generator[Told | Step, Any, Result]:
        full_id = yield from self._full_id(job_id)  # pyright: ignore[reportPrivateUsage]
        return (yield from call(self, full_id, *more, **also))

    return named


def the_one(name: str, ids: Sequence[str], what: str) -> str:
    """The id, of these newest first, that `last`, a beginning or an end means.

    what: of which kind they are, for the sentence. Raises LookupError, where none or several fit.
    """
    if name == "last":
        if ids:
            return ids[0]
        raise LookupError(f"There is no {what} yet.")
    fitting = [one for one in ids if one.startswith(name) or one.endswith(name)]
    if len(fitting) == 1:
        return fitting[0]
    if not fitting:
        raise LookupError(
            f"None of the newest {SEARCHED:,} {what}s has an id that begins or ends with {name!r}."
        )
    raise LookupError(f"{name!r} fits {len(fitting)} {what}s: {', '.join(fitting[:5])}. Give more of the id.")


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
