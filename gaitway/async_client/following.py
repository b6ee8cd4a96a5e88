"""Follows a job's feed and its log as they grow, through broken connections, without a busy loop."""

import time
from collections.abc import AsyncIterator
from dataclasses import dataclass

from gaitway.addresses import path_of
from gaitway.async_client.connection import AsyncConnection
from gaitway.concurrency import async_sleep
from gaitway.errors import Unavailable, Unreachable
from gaitway.retry import Retry
from gaitway.schema import JobView
from gaitway.views import Event, LineReader, Stream, event_of

_SILENCE_S = 45.0  # the service sends at least a comment more often than this
_LOG_SILENCE_S = 300.0  # a log has no comments


@dataclass
class _Losses:
    """How many connections in a row brought nothing, and since when the service is unavailable."""

    retry: Retry
    failures: int = 0
    since: float | None = None

    def note(self, error: Exception) -> None:
        """Raises the error when the service has been unavailable for too long."""
        now = time.monotonic()
        self.since = now if self.since is None else self.since
        if now - self.since > self.retry.patience_s:
            raise error

    def forget(self) -> None:
        self.failures, self.since = 0, None

    def delay_s(self) -> float:
        """The pause after one more connection that brought nothing."""
        self.failures += 1
        return self.retry.delay_s(self.failures)


class AsyncFollowing(AsyncConnection):
    """Follows feeds and logs."""

    async def _follow(
        self, job_id: str, after: str | None = None, deadline: float | None = None
    ) -> AsyncIterator[Event]:
        """Events as they arrive, each once, until the job's end or the deadline (`time.monotonic`).

        A broken connection is resumed after the last event seen. Raises ApiError, and Unreachable when the
        service is unavailable for longer than `Retry.patience_s`.
        """
        job_id = await self._full_id(job_id)
        path = path_of("jobs", job_id, "events")
        seen, losses = after or "", _Losses(self._retry)
        while (left_s := _left_s(deadline)) > 0:
            before = seen
            silence_s = min(_SILENCE_S, max(0.05, left_s))
            headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": seen} if seen else {})
            try:
                async with self._opened(path, headers=headers, read_timeout_s=silence_s) as response:
                    stream = Stream(seen)
                    async for chunk in response.aiter_bytes():
                        for event in map(event_of, stream.take(chunk)):
                            seen = event.id or seen
                            losses.forget()
                            yield event
                            if event.is_end:
                                return
                        # A connection's read timeout is fixed when it is made. Once it exceeds the time left
                        # by a tenth, a new connection is made.
                        if silence_s * 0.9 > _left_s(deadline):
                            break
                losses.since = None
                # The service closes a feed at the job's end; otherwise the connection was lost.
                if seen == before and await self._has_ended(job_id):
                    return
            except (Unreachable, Unavailable) as error:
                losses.note(error)
            if seen == before and (left_s := _left_s(deadline)) > 0:
                await async_sleep(min(losses.delay_s(), left_s))

    async def _follow_log(self, job_id: str) -> AsyncIterator[str]:
        """Lines of a log from its beginning, each once, until the job's end; raises as `_follow` does."""
        job_id = await self._full_id(job_id)
        path = path_of("jobs", job_id, "logs")
        num_lines, losses = 0, _Losses(self._retry)
        while True:
            before = num_lines
            try:
                async with self._opened(
                    path, params={"follow": "true"}, read_timeout_s=_LOG_SILENCE_S
                ) as response:
                    # A log has no ids: after a broken connection it starts from its beginning again.
                    lines, num_seen = LineReader(), 0
                    async for chunk in response.aiter_bytes():
                        for line in lines.take(chunk):
                            num_seen += 1
                            if num_seen > num_lines:
                                num_lines = num_seen
                                losses.forget()
                                yield line
                if await self._has_ended(job_id):
                    return
            except (Unreachable, Unavailable) as error:
                losses.note(error)
            if num_lines == before:
                await async_sleep(losses.delay_s())

    async def _has_ended(self, job_id: str) -> bool:
        return (await self._get(path_of("jobs", job_id), JobView)).is_final


def _left_s(deadline: float | None) -> float:
    return float("inf") if deadline is None else deadline - time.monotonic()
