"""A job's feeds as streams that end when the job does.

A waiting client costs no thread: the feed is read in a thread (of a pool of its own, so that watchers
never keep other requests waiting), and between two reads the stream sleeps, 0.1 s after news and up to
1 s in silence.
"""

from collections.abc import AsyncIterator, Sequence

import anyio
import structlog
from anyio import to_thread

from api.dependencies import Service
from core.errors import JobNotFound, Unavailable
from core.jobs.job import Job
from core.jobs.store import Channel, Entry

log = structlog.get_logger()

HEARTBEAT_S = 15.0
_PAGE = 500
_SHORTEST_PAUSE_S = 0.1
_LONGEST_PAUSE_S = 1.0


class Follower:
    """Reads one feed of one job. `job` is the job as it was at the latest look, None once it is deleted."""

    def __init__(self, service: Service, job: Job, channel: Channel, after: str) -> None:
        self.job: Job | None = job
        self._service = service
        self._id = job.id
        self._channel: Channel = channel
        self._after = after

    async def pages(self, *, to_the_end: bool) -> AsyncIterator[Sequence[Entry]]:
        """Entries as they come; an empty page means that nothing has come for a while.

        Ends at the feed's present end, or with `to_the_end` when the job has ended, was deleted, or the
        service stops. Raises RecordsUnavailable, but not with `to_the_end`: that outlives an outage.
        """
        pause_s, silence_s = _SHORTEST_PAUSE_S, 0.0
        while not self._service.stopping:
            try:
                page = await to_thread.run_sync(self._read, limiter=self._service.watching)
                is_last = len(page) < _PAGE and (not to_the_end or self._has_ended)
            except Unavailable as error:
                if not to_the_end:
                    raise
                log.warning("feed_unavailable", job_id=self._id, error=error.detail)
                page, is_last = (), False
            if page:
                self._after = page[-1].id
            if page or silence_s >= HEARTBEAT_S:
                pause_s, silence_s = _SHORTEST_PAUSE_S if page else pause_s, 0.0
                yield page
            if is_last:
                return
            if len(page) < _PAGE:
                await anyio.sleep(pause_s)
                silence_s += pause_s
                pause_s = min(1.5 * pause_s, _LONGEST_PAUSE_S)

    @property
    def _has_ended(self) -> bool:
        return self.job is None or self.job.status.is_final

    def _read(self) -> Sequence[Entry]:
        # The job first: what is in the feed after its end was seen is all that there will be.
        try:
            self.job = self._service.store.get(self._id)
            return self._service.store.feed(self._id, self._channel, after=self._after, limit=_PAGE)
        except JobNotFound:
            self.job = None
            return ()
