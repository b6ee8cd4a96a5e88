"""Follows a job's feed as it grows, through broken connections, without a busy loop."""

import json
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

from gaitway import sse
from gaitway.errors import Unavailable, Unreachable
from gaitway.retry import Retry
from gaitway.steps import Call, Feed, Found, Open, Read, Request, Sleep, Step
from gaitway.views import Event

_SILENCE_S = 45.0  # the service sends at least a comment more often than this
_LOG_SILENCE_S = 300.0  # a log has no comments


@dataclass
class _Place:
    """Where a follower is: the last id that it saw, and how many connections in a row brought nothing."""

    after: str
    failures: int = 0
    lost_since: float | None = None


def follow_feed(
    retry: Retry,
    path: str,
    has_ended: Callable[[], Call[bool]],
    after: str | None = None,
    deadline: float | None = None,
) -> Feed:
    """Entries of a feed as they arrive, each once, until the job's end or the deadline (`time.monotonic`).

    A broken connection is resumed after the last entry seen. Raises ApiError, and Unreachable when the
    service is unavailable for longer than `Retry.patience_s`.
    """
    place = _Place(after or "")
    while not _is_past(deadline):
        before = place.after
        try:
            if (yield from _one_connection(path, place, deadline)):
                return
            place.lost_since = None
            # The service closes a feed at the job's end; otherwise the connection was lost.
            if place.after == before and (yield from has_ended()):
                return
        except (Unreachable, Unavailable) as error:
            _note_loss(place, retry, error)
        if place.after == before and not _is_past(deadline):
            place.failures += 1
            wait_s = retry.delay_s(place.failures)
            yield Sleep(wait_s if deadline is None else min(wait_s, max(0.0, deadline - time.monotonic())))


def follow_log(retry: Retry, path: str, has_ended: Callable[[], Call[bool]]) -> Feed:
    """Lines of a log from its beginning, each once, until the job's end; raises as `follow_feed` does."""
    num_lines, place = 0, _Place("")
    asked = Request("GET", path, params={"follow": "true"}, read_timeout_s=_LOG_SILENCE_S)
    while True:
        before = num_lines
        try:
            yield Open(asked)
            # A log has no ids: after a broken connection it starts from its beginning again.
            lines, num_seen = sse.Lines(), 0
            while (chunk := (yield Read())) is not None:
                for line in lines.take(chunk):
                    num_seen += 1
                    if num_seen > num_lines:
                        num_lines, place = num_seen, _Place("")
                        yield Found(line)
            if (yield from has_ended()):
                return
        except (Unreachable, Unavailable) as error:
            _note_loss(place, retry, error)
        if num_lines == before:
            place.failures += 1
            yield Sleep(retry.delay_s(place.failures))


def _one_connection(path: str, place: _Place, deadline: float | None) -> Generator[Step | Found, Any, bool]:
    """Reads until the connection or the time ends; returns whether the job has ended."""
    silence_s = _SILENCE_S if deadline is None else min(_SILENCE_S, max(0.05, deadline - time.monotonic()))
    headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": place.after} if place.after else {})
    yield Open(Request("GET", path, headers=headers, read_timeout_s=silence_s))
    lines, parser = sse.Lines(), sse.Parser(place.after)
    while (chunk := (yield Read())) is not None:
        for line in lines.take(chunk):
            item = parser.take(line)
            if isinstance(item, sse.ServerSentEvent):
                event = event_of(item)
                place.after, place.failures, place.lost_since = event.id or place.after, 0, None
                yield Found(event)
                if event.is_end:
                    return True
            # A connection's read timeout is fixed when it is made. Once it exceeds the time left by a tenth,
            # a new connection is made.
            if item is not None and deadline is not None and time.monotonic() + silence_s * 0.9 > deadline:
                return False
    return False


def event_of(item: sse.ServerSentEvent) -> Event:
    """The entry that a server-sent event carries."""
    document: dict[str, Any] = json.loads(item.data)
    return Event(id=item.id, kind=item.kind, time=document.get("time"), data=document.get("data", {}))


def _is_past(deadline: float | None) -> bool:
    return deadline is not None and time.monotonic() >= deadline


def _note_loss(place: _Place, retry: Retry, error: Exception) -> None:
    """Raises the error when the service has been unavailable for too long."""
    now = time.monotonic()
    place.lost_since = now if place.lost_since is None else place.lost_since
    if now - place.lost_since > retry.patience_s:
        raise error
