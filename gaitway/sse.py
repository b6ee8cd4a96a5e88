"""Server-sent events, read line by line (WHATWG HTML, section 9.2.6)."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

_LINE_END = re.compile(rb"\r\n|\n|\r(?!$)")  # a CR at the very end may be half of a CRLF: wait for more


@dataclass(frozen=True)
class ServerSentEvent:
    """id: the latest id the stream named, which a reconnection sends as Last-Event-ID."""

    kind: str
    data: str
    id: str


@dataclass(frozen=True)
class Comment:
    """A line without data, which shows that the connection is alive."""


def parse(lines: Iterable[str], last_id: str = "") -> Iterator[ServerSentEvent | Comment]:
    """Events of a stream given as lines without their ends; one cut off by the stream's end is dropped."""
    kind, data = "", list[str]()
    for line in lines:
        if not line:
            if data:
                yield ServerSentEvent(kind or "message", "\n".join(data), last_id)
            kind, data = "", []
            continue
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "":
            yield Comment()
        elif name == "event":
            kind = value
        elif name == "data":
            data.append(value)
        elif name == "id" and "\0" not in value:
            last_id = value


def lines(chunks: Iterable[bytes]) -> Iterator[str]:
    """The lines of a UTF-8 stream; only CR, LF and CRLF end one (unlike `str.splitlines`)."""
    rest = b""
    for chunk in chunks:
        *whole, rest = _LINE_END.split(rest + chunk)
        for line in whole:
            yield line.decode("utf-8", "replace")
