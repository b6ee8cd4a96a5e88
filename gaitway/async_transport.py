"""HTTP for `AsyncClient`: takes the steps of calls in an event loop."""

from collections.abc import AsyncGenerator, AsyncIterator
from pathlib import Path
from typing import Any, TypeVar

import anyio
import anyio.to_thread
import httpx

from gaitway.errors import problem_of
from gaitway.steps import Call, Course, Feed, Found, Open, Read, Run, Send, Sleep, Step
from gaitway.transport import PIECE_BYTES, Address, is_refusal, reachable

Result = TypeVar("Result")


class AsyncTransport(Address):
    """One connection pool to one service; awaits steps."""

    def __init__(self, base_url: str, timeout_s: float, http: httpx.AsyncClient | None = None) -> None:
        super().__init__(base_url, timeout_s)
        self._http = http or httpx.AsyncClient(**self.options)

    async def close(self) -> None:
        await self._http.aclose()

    async def do(self, call: Call[Result]) -> Result:
        """Take all steps of a call. Raises what the call raises."""
        course = Course(call)
        async for _ in self._items(course):
            pass
        return course.result

    async def each(self, feed: Feed) -> AsyncGenerator[Any]:
        """What a feed finds, as it finds it."""
        async for item in self._items(Course(feed)):
            yield item

    async def _items(self, course: Course[Any]) -> AsyncGenerator[Any]:
        opened = _AsyncOpened()
        try:
            while (step := course.step) is not None:
                if isinstance(step, Found):
                    yield step.item
                    course.answer(None)
                    continue
                try:
                    answer = await self._take(step, opened)
                except Exception as error:
                    course.fail(error)
                else:
                    course.answer(answer)
        finally:
            with anyio.CancelScope(shield=True):
                await opened.close()
            course.close()

    async def _take(self, step: Step, opened: "_AsyncOpened") -> Any:
        match step:
            case Send(request):
                with reachable(self.base_url):
                    return await self._http.send(self.build(self._http, request, _pieces_of))
            case Open(request):
                await opened.close()
                with reachable(self.base_url):
                    built = self.build(self._http, request, _pieces_of)
                    response = await self._http.send(built, stream=True)
                    opened.response = response
                    if is_refusal(response):
                        await response.aread()
                        raise problem_of(response)
                    return response
            case Read(raw):
                with reachable(self.base_url):
                    return await opened.read(raw)
            case Sleep(seconds):
                await anyio.sleep(seconds)
                return None
            case Run(function):
                return await anyio.to_thread.run_sync(function)


async def _pieces_of(path: Path) -> AsyncIterator[bytes]:
    """The file in pieces, read by other threads."""
    async with await anyio.open_file(path, "rb") as file:
        while piece := await file.read(PIECE_BYTES):
            yield piece


class _AsyncOpened:
    """The answer that is being read, if there is one."""

    def __init__(self) -> None:
        self.response: httpx.Response | None = None
        self._pieces: AsyncIterator[bytes] | None = None

    async def read(self, raw: bool) -> bytes | None:
        assert self.response is not None  # noqa: S101 # A call opens before it reads.
        if self._pieces is None:
            self._pieces = self.response.aiter_raw() if raw else self.response.aiter_bytes()
        return await anext(self._pieces, None)

    async def close(self) -> None:
        if self.response is not None:
            await self.response.aclose()
        self.response = self._pieces = None
