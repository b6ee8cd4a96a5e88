"""What a client does, step by step, without doing it: no connection is opened here, and nobody waits.

A call is a generator. It yields steps, is sent the answer of each, and returns its result; a feed also yields
what it found. `Client` takes the steps in the calling thread, `AsyncClient` awaits them, so that each call is
written once (in `gaitway.calls`).
"""

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

Params = Mapping[str, Any]
Result = TypeVar("Result")


@dataclass(frozen=True)
class Request:
    """One HTTP request. file: its content, sent in pieces. read_timeout_s: by default the client's."""

    method: str
    path: str
    params: Params | None = None
    json: Any = None
    content: bytes | None = None
    file: Path | None = None
    headers: Mapping[str, str] | None = None
    read_timeout_s: float | None = None


@dataclass(frozen=True)
class Send:
    """Send it, once. The answer: an httpx.Response with its body. Raises Unreachable."""

    request: Request


@dataclass(frozen=True)
class Open:
    """Send it, once. The answer: an httpx.Response whose body `Read` reads; it closes one opened before.

    Raises ApiError for a refusal, and Unreachable.
    """

    request: Request


@dataclass(frozen=True)
class Read:
    """The answer: the next bytes of what was opened, None at its end. raw: as they were sent, not decoded.

    Raises Unreachable where the connection breaks.
    """

    raw: bool = False


@dataclass(frozen=True)
class Sleep:
    """Wait."""

    seconds: float


@dataclass(frozen=True)
class Run:
    """Call a function that takes time. The answer: what it returns."""

    function: Callable[[], Any]


@dataclass(frozen=True)
class Found:
    """Hand an item to whoever reads the feed."""

    item: Any


Step = Send | Open | Read | Sleep | Run
Call = Generator[Step, Any, Result]
Feed = Generator[Step | Found, Any, None]


class Course(Generic[Result]):
    """A call under way. step: the next one, None at the end; result: what the call then returned."""

    def __init__(self, call: Generator[Step | Found, Any, Result]) -> None:
        self._call = call
        self.step: Step | Found | None = None
        self._result: list[Result] = []
        self._advance(lambda: next(call))

    @property
    def result(self) -> Result:
        return self._result[0]

    def answer(self, value: Any) -> None:
        self._advance(lambda: self._call.send(value))

    def fail(self, error: Exception) -> None:
        self._advance(lambda: self._call.throw(error))

    def close(self) -> None:
        """Give up the rest."""
        self._call.close()

    def _advance(self, go: Callable[[], Step | Found]) -> None:
        try:
            self.step = go()
        except StopIteration as end:
            self.step, self._result = None, [end.value]


def read_through(feed: Feed, on_item: Callable[[Any], Call[Any] | None] = lambda item: None) -> Call[None]:
    """Take all steps of a feed. on_item: gets each item; it may return a call, which is then taken, too."""
    course = Course(feed)
    while (step := course.step) is not None:
        if isinstance(step, Found):
            if (then := on_item(step.item)) is not None:
                yield from then
            course.answer(None)
            continue
        try:
            answer = yield step
        except Exception as error:
            course.fail(error)
        else:
            course.answer(answer)
