"""A job's feeds as streams that end when the job does; events are server-sent (WHATWG HTML, section 9.2).

A waiting client costs neither a thread nor a query: the process has one `JobWatcher`, which tells when a job
has changed, and only then is the feed read, once for all who have read it up to the same entry. Streams read
in a thread pool of their own, so that they never keep other requests waiting.

FastAPI's own `EventSourceResponse` does not fit: it sends 200 before the first entry is read, but a browser
that reconnects after the end must get 204, which makes it stop.
"""

import time
from collections.abc import AsyncIterator, Collection, Sequence

import msgspec
import structlog
from anyio import to_thread

from api.dependencies import Service
from api.views import job_view
from core.errors import JobNotFound, Unavailable
from core.jobs import feeds
from core.jobs.job import Job, UnreadableJob
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry

log = structlog.get_logger()
_encoder = msgspec.json.Encoder()

HEARTBEAT_S = 15.0
_PAGE = 500
# How often a waiting stream checks whether the service is stopping or a heartbeat is due.
_POLL_S = 1.0
MEDIA_TYPE = "text/event-stream"
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}


class Follower:
    """Reads one feed of one job. `status`: the job's at the last read, None once it is deleted."""

    def __init__(self, service: Service, job: Job | UnreadableJob, channel: Channel, after: int) -> None:
        self.status: JobStatus | None = job.status
        self._service = service
        self._id = job.id
        self._channel: Channel = channel
        self._after = after
        self._is_end = False

    async def present(self) -> AsyncIterator[Sequence[Entry]]:
        """Entries up to the feed's current end. Raises RecordsUnavailable, StorageUnavailable."""
        while not self._is_end:
            if page := self._took(await self._next()):
                yield page

    async def coming(self) -> AsyncIterator[Sequence[Entry]]:
        """Entries as they arrive; an empty page is a heartbeat in a silence.

        Ends when the job has ended or was deleted, or when the service stops. It survives outages of the
        stores.
        """
        heard_at = time.monotonic()
        is_due, is_last = True, False
        with self._service.watcher.watch(self._id) as watch:
            while not (is_last or self._service.stopping):
                page: Sequence[Entry] = ()
                has_more = False  # Stays false in an outage, so that the next read waits.
                if is_due:
                    try:
                        page = await self._read_with_others()
                    except Unavailable as error:
                        log.warning("feed_unavailable", job_id=self._id, error=error.detail)
                    else:
                        is_due = has_more = not self._is_end
                        is_last = self._is_end and (self.status is None or self.status.is_final)
                if page or time.monotonic() - heard_at >= HEARTBEAT_S:
                    heard_at = time.monotonic()
                    yield page
                if not (has_more or is_last):
                    is_due = await watch.news(_POLL_S) or is_due

    async def job(self) -> Job | UnreadableJob:
        """The job as it is now. Raises JobNotFound, RecordsUnavailable."""
        return await to_thread.run_sync(self._service.store.find, self._id, limiter=self._service.watching)

    async def _read_with_others(self) -> Sequence[Entry]:
        # A reading that began under the same mark holds what the mark told of.
        known = self._service.watcher.mark(self._id)
        question = (self._id, self._channel, self._after, known)
        return self._took(await self._service.feed_reads.read(question, self._next))

    async def _next(self) -> feeds.FeedPage | None:
        return await to_thread.run_sync(self._next_page, limiter=self._service.watching)

    def _took(self, page: feeds.FeedPage | None) -> Sequence[Entry]:
        """The entries of the page, which is the last one read. None: the job is deleted."""
        self.status, self._is_end = (None, True) if page is None else (page.status, page.is_end)
        if page is None:
            return ()
        self._after = page.last
        return page.entries

    def _next_page(self) -> feeds.FeedPage | None:
        store, objects = self._service.store, self._service.objects
        try:
            return feeds.read_page(self._id, self._channel, self._after, _PAGE, store=store, objects=objects)
        except JobNotFound:
            return None


def look(service: Service, job_id: str, channel: Channel, after: int = 0) -> tuple[Job | UnreadableJob, bool]:
    """The job, and whether its feed has entries after `after`. Errors arise here, before a stream begins."""
    job = service.store.find(job_id)
    page = feeds.read_page(job_id, channel, after, 1, store=service.store, objects=service.objects)
    return job, bool(page.entries)


async def event_stream(
    follower: Follower, kinds: Collection[str] = (), *, follow: bool = True
) -> AsyncIterator[bytes]:
    """The entries of these kinds (none: of all), a comment in each silence, at the end the final status.

    Without `follow`, only the present entries.
    """
    told = False
    yield b"retry: 2000\n\n"
    async for page in follower.coming() if follow else follower.present():
        told = told or any(_is_the_end(entry) for entry in page)
        wanted = [entry for entry in page if not kinds or entry.kind in kinds or _is_the_end(entry)]
        yield encoded(wanted) if wanted else b": still here\n\n"
    if not follow:
        return
    if follower.status is not None and follower.status.is_final and not told:
        # The feed of an imported job need not have its end.
        yield encoded([_final(await follower.job())])


def encoded(entries: Sequence[Entry]) -> bytes:
    """Entries as bytes. data: a JSON object {"time", "data"}; numbers that are not finite become null."""
    return b"".join(
        b"%bevent: %b\ndata: %b\n\n"
        % (
            b"id: %b\n" % entry.id.encode() if entry.id else b"",
            entry.kind.encode(),
            _encoder.encode({"time": entry.time, "data": entry.data}),
        )
        for entry in entries
    )


def _is_the_end(entry: Entry) -> bool:
    return entry.kind == "status" and JobStatus(entry.data["status"]).is_final


def _final(job: Job | UnreadableJob) -> Entry:
    view = job_view(job)
    data = {
        "status": view.status,
        "reason": view.reason,
        "message": view.message,
        "attempt": len(view.attempts),
    }
    return Entry(kind="status", time=job.finished_at or job.created_at, data=data)
