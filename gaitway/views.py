"""The client's forms of answers: pages of lists, and server-sent events (WHATWG HTML, section 9.2.6)."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Generic, TypeVar

from gaitway.schema import FINAL_STATUSES, View

Item = TypeVar("Item")
_LINE_END = re.compile(rb"\r\n|\n|\r(?!$)")  # a CR at the very end may be half of a CRLF: wait for more


@dataclass(frozen=True)
class ServerSentEvent:
    """id: the latest id the stream named, which a reconnection sends as Last-Event-ID."""

    kind: str
    data: str
    id: str


class LineReader:
    """Makes lines of a UTF-8 stream; only CR, LF and CRLF end one (unlike `str.splitlines`)."""

    def __init__(self) -> None:
        self._rest = b""

    def take(self, chunk: bytes) -> list[str]:
        """The lines that these bytes complete."""
        *whole, self._rest = _LINE_END.split(self._rest + chunk)
        return [line.decode("utf-8", "replace") for line in whole]


class Stream:
    """Makes events of a stream's bytes; one cut off by the stream's end is dropped, as comments are.

    last_id: the latest id of the connection before.
    """

    def __init__(self, last_id: str = "") -> None:
        self._lines = LineReader()
        self._last_id = last_id
        self._kind = ""
        self._data = list[str]()

    def take(self, chunk: bytes) -> list[ServerSentEvent]:
        """The events that these bytes complete."""
        return [event for line in self._lines.take(chunk) if (event := self._take_line(line)) is not None]

    def _take_line(self, line: str) -> ServerSentEvent | None:
        if not line:
            kind, data = self._kind or "message", self._data
            self._kind, self._data = "", []
            return ServerSentEvent(kind, "\n".join(data), self._last_id) if data else None
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._kind = value
        elif name == "data":
            self._data.append(value)
        elif name == "id" and "\0" not in value:
            self._last_id = value
        return None


class Page(View, Generic[Item]):
    """Some items, and the cursor of the next page (None at the end).

    of_newest: how many of the newest jobs a sorted list is of, where it leaves older ones out.
    """

    items: list[Item]
    next: str | None = None
    of_newest: int | None = None

    def __iter__(self) -> Iterator[Item]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)


class Event(View):
    """Something that happened to a job. kind: status, progress, metrics, artifact, phase, or line."""

    id: str = ""
    kind: str
    time: datetime | None = None
    data: dict[str, Any] = {}

    @property
    def is_end(self) -> bool:
        """Whether the job has ended with this."""
        return self.kind == "status" and self.data.get("status") in FINAL_STATUSES


def event_of(sent: ServerSentEvent) -> Event:
    """The entry of a feed that a server-sent event carries."""
    document: dict[str, Any] = json.loads(sent.data)
    return Event(id=sent.id, kind=sent.kind, time=document.get("time"), data=document.get("data", {}))
