"""HTTP for `Client`: takes the steps of calls in the calling thread."""

import time
from collections.abc import AsyncIterable, Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import httpx

from gaitway.errors import Unreachable, problem_of
from gaitway.steps import Call, Course, Feed, Found, Open, Read, Request, Run, Send, Sleep, Step

Result = TypeVar("Result")

PIECE_BYTES = 2**20


class Address:
    """The service's address, and how long a request to it may take."""

    def __init__(self, base_url: str, timeout_s: float) -> None:
        self.base_url = base_url.rstrip("/")
        self.timeout = httpx.Timeout(timeout_s, connect=min(timeout_s, 5.0))

    @property
    def options(self) -> dict[str, Any]:
        """Of an httpx client. A proxy from the environment does not reach services on this machine."""
        is_here = httpx.URL(self.base_url).host in ("127.0.0.1", "localhost", "::1")
        return {
            "base_url": self.base_url,
            "timeout": self.timeout,
            "follow_redirects": True,
            "trust_env": not is_here,
        }

    def build(
        self,
        http: httpx.Client | httpx.AsyncClient,
        request: Request,
        pieces_of: Callable[[Path], Iterable[bytes] | AsyncIterable[bytes]],
    ) -> httpx.Request:
        """pieces_of: how the client reads a file that it sends."""
        seconds = self.timeout.as_dict()
        timeout = httpx.Timeout(**{**seconds, "read": request.read_timeout_s or seconds["read"]})
        content, headers = request.content, dict(request.headers or {})
        if request.file is not None:
            content = pieces_of(request.file)
            headers["Content-Length"] = str(request.file.stat().st_size)
        return http.build_request(
            request.method,
            request.path,
            params=request.params,
            json=request.json,
            content=content,
            headers=headers,
            timeout=timeout,
        )


class Transport(Address):
    """One connection pool to one service; takes steps in the calling thread."""

    def __init__(self, base_url: str, timeout_s: float, http: httpx.Client | None = None) -> None:
        super().__init__(base_url, timeout_s)
        self._http = http or httpx.Client(**self.options)

    def close(self) -> None:
        self._http.close()

    def do(self, call: Call[Result]) -> Result:
        """Take all steps of a call. Raises what the call raises."""
        course = Course(call)
        for _ in self._items(course):
            pass
        return course.result

    def each(self, feed: Feed) -> Iterator[Any]:
        """What a feed finds, as it finds it."""
        yield from self._items(Course(feed))

    def _items(self, course: Course[Any]) -> Iterator[Any]:
        opened = _Opened()
        try:
            while (step := course.step) is not None:
                if isinstance(step, Found):
                    yield step.item
                    course.answer(None)
                    continue
                try:
                    answer = self._take(step, opened)
                except Exception as error:
                    course.fail(error)
                else:
                    course.answer(answer)
        finally:
            opened.close()
            course.close()

    def _take(self, step: Step, opened: "_Opened") -> Any:
        match step:
            case Send(request):
                with reachable(self.base_url):
                    return self._http.send(self.build(self._http, request, pieces_of))
            case Open(request):
                opened.close()
                with reachable(self.base_url):
                    built = self.build(self._http, request, pieces_of)
                    response = opened.response = self._http.send(built, stream=True)
                    if is_refusal(response):
                        response.read()
                        raise problem_of(response)
                    return response
            case Read(raw):
                with reachable(self.base_url):
                    return opened.read(raw)
            case Sleep(seconds):
                time.sleep(seconds)
                return None
            case Run(function):
                return function()


class _Opened:
    """The answer that is being read, if there is one."""

    def __init__(self) -> None:
        self.response: httpx.Response | None = None
        self._pieces: Iterator[bytes] | None = None

    def read(self, raw: bool) -> bytes | None:
        assert self.response is not None  # noqa: S101 # A call opens before it reads.
        if self._pieces is None:
            self._pieces = self.response.iter_raw() if raw else self.response.iter_bytes()
        return next(self._pieces, None)

    def close(self) -> None:
        if self.response is not None:
            self.response.close()
        self.response = self._pieces = None


def pieces_of(path: Path) -> Iterator[bytes]:
    """The file in pieces."""
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            yield piece


def is_refusal(response: httpx.Response) -> bool:
    """Whether it is a problem, whose body tells more."""
    return not response.is_success and response.status_code != 304


@contextmanager
def reachable(url: str) -> Generator[None]:
    """Raises Unreachable for whatever keeps an answer from coming."""
    try:
        yield
    except (httpx.TransportError, httpx.StreamError) as error:
        raise Unreachable(url, str(error) or type(error).__name__) from error
    except (httpx.InvalidURL, httpx.TooManyRedirects, httpx.DecodingError) as error:
        raise Unreachable(url, str(error)) from error
