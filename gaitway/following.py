"""Follows a job's feed as it grows, through broken connections, without a busy loop."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

from gaitway import sse
from gaitway.errors import Unavailable, Unreachable
from gaitway.transport import Transport
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
    transport: Transport,
    path: str,
    has_ended: Callable[[], bool],
    after: str | None = None,
    deadline: float | None = None,
) -> Iterator[Event]:
    """Entries of a feed as they arrive, each once, until the job's end or the deadline (`time.monotonic`).

    A broken connection is resumed after the last entry seen. Raises ApiError, and Unreachable when the
    service is unavailable for longer than `Retry.patience_s`.
    """
    place = _Place(after or "")
    while not _is_past(deadline):
        before = place.after
        try:
            for event in _one_connection(transport, path, place.after, deadline):
                place = _Place(event.id or place.after)
                yield event
                if event.is_end:
                    return
            place.lost_since = None
            # The service closes a feed at the job's end; otherwise the connection was lost.
            if place.after == before and has_ended():
                return
        except (Unreachable, Unavailable) as error:
            _note_loss(place, transport, error)
        if place.after == before and not _is_past(deadline):
            place.failures += 1
            wait_s = transport.retry.delay_s(place.failures)
            time.sleep(wait_s if deadline is None else min(wait_s, max(0.0, deadline - time.monotonic())))


def follow_log(transport: Transport, path: str, has_ended: Callable[[], bool]) -> Iterator[str]:
    """Lines of a log from its beginning, each once, until the job's end; raises as `follow_feed` does."""
    num_lines, place = 0, _Place("")
    while True:
        before = num_lines
        try:
            with transport.stream(path, params={"follow": "true"}, read_timeout_s=_LOG_SILENCE_S) as response:
                # A log has no ids: after a broken connection it starts from its beginning again.
                for line in islice(sse.lines(response.iter_bytes()), before, None):
                    num_lines, place = num_lines + 1, _Place("")
                    yield line
            if has_ended():
                return
        except (Unreachable, Unavailable) as error:
            _note_loss(place, transport, error)
        if num_lines == before:
            place.failures += 1
            time.sleep(transport.retry.delay_s(place.failures))


def _one_connection(transport: Transport, path: str, after: str, deadline: float | None) -> Iterator[Event]:
    silence_s = _SILENCE_S if deadline is None else min(_SILENCE_S, max(0.05, deadline - time.monotonic()))
    headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": after} if after else {})
    with transport.stream(path, headers=headers, read_timeout_s=silence_s) as response:
        for item in sse.parse(sse.lines(response.iter_bytes()), after):
            if isinstance(item, sse.ServerSentEvent):
                yield event_of(item)
            # A connection's read timeout is fixed when it is made. Once it exceeds the time left by a tenth,
            # a new connection is made.
            if deadline is not None and time.monotonic() + silence_s * 0.9 > deadline:
                return


def event_of(item: sse.ServerSentEvent) -> Event:
    """The entry that a server-sent event carries."""
    document: dict[str, Any] = json.loads(item.data)
    return Event(id=item.id, kind=item.kind, time=document.get("time"), data=document.get("data", {}))


def _is_past(deadline: float | None) -> bool:
    return deadline is not None and time.monotonic() >= deadline


def _note_loss(place: _Place, transport: Transport, error: Exception) -> None:
    """Raises the error when the service has been unavailable for too long."""
    now = time.monotonic()
    place.lost_since = now if place.lost_since is None else place.lost_since
    if now - place.lost_since > transport.retry.patience_s:
        raise error
