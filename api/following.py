"""A job's feeds as streams that end when the job does.

A waiting client costs neither a thread nor a query: the process' one `JobWatcher` tells when its job has
news, and only then the feed is read, in a thread of a pool apart, so that streams never keep other requests
waiting.
"""

import time
from collections.abc import AsyncIterator, Sequence

import structlog
from anyio import to_thread

from api.dependencies import Service
from core.errors import JobNotFound, ObjectNotFound, Unavailable
from core.jobs.job import Job, UnreadableJob
from core.jobs.store import Channel, Entry

log = structlog.get_logger()

HEARTBEAT_S = 15.0
_PAGE = 500
# How often a waiting stream looks whether the service stops, or a heartbeat is due.
_GLANCE_S = 1.0


class Follower:
    """Reads one feed of one job. `job` is the job as it was at the latest look, None once it is deleted."""

    def __init__(self, service: Service, job: Job | UnreadableJob, channel: Channel, after: int) -> None:
        self.job: Job | UnreadableJob | None = job
        self._service = service
        self._id = job.id
        self._channel: Channel = channel
        self._after = after

    async def present(self) -> AsyncIterator[Sequence[Entry]]:
        """Entries up to the feed's present end. Raises RecordsUnavailable, StorageUnavailable."""
        is_last = False
        while not is_last:
            page = await self._read()
            is_last = len(page) < _PAGE
            if page:
                yield page

    async def coming(self) -> AsyncIterator[Sequence[Entry]]:
        """Entries as they come; an empty page means that nothing has come for a while.

        Ends when the job has ended, was deleted, or the service stops. It outlives outages of the stores.
        """
        heard_at = time.monotonic()
        is_due, is_last = True, False
        with self._service.watcher.watch(self._id) as watch:
            while not (is_last or self._service.stopping):
                page: Sequence[Entry] = ()
                if is_due:
                    try:
                        page = await self._read()
                    except Unavailable as error:
                        log.warning("feed_unavailable", job_id=self._id, error=error.detail)
                    else:
                        is_due = len(page) == _PAGE
                        is_last = self._has_ended and not is_due
                if page or time.monotonic() - heard_at >= HEARTBEAT_S:
                    heard_at = time.monotonic()
                    yield page
                if len(page) < _PAGE and not is_last:
                    is_due = await watch.news(_GLANCE_S) or is_due

    @property
    def _has_ended(self) -> bool:
        return self.job is None or self.job.status.is_final

    async def _read(self) -> Sequence[Entry]:
        page = await to_thread.run_sync(self._next_page, limiter=self._service.watching)
        if page:
            self._after = int(page[-1].id)
        return page

    def _next_page(self) -> Sequence[Entry]:
        # The job first: what is in the feed after its end was seen is all that there will be.
        try:
            self.job = self._service.store.find(self._id)
            return self._service.read_feed(self._id, self._channel, after=self._after, limit=_PAGE)
        except (JobNotFound, ObjectNotFound):  # A deletion removes the objects first.
            self.job = None
            return ()


def look(service: Service, job_id: str, channel: Channel, after: int = 0) -> tuple[Job | UnreadableJob, bool]:
    """The job, and whether its feed goes beyond `after`; what is wrong is raised before a stream begins."""
    job = service.store.find(job_id)
    return job, bool(service.read_feed(job_id, channel, after=after, limit=1))
