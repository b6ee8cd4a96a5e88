"""A job's events as server-sent events (WHATWG HTML, section 9.2).

FastAPI's own `EventSourceResponse` does not fit: it sends 200 before the first entry is read, but a browser
that reconnects after the end must get 204, which makes it stop.
"""

from collections.abc import AsyncIterator, Collection, Sequence

from pydantic_core import to_json

from api.following import Follower
from api.views import job_view
from core.jobs.job import Job, UnreadableJob
from core.jobs.status import JobStatus
from core.jobs.store import Entry

MEDIA_TYPE = "text/event-stream"
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}


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
        (f"id: {entry.id}\n" if entry.id else "").encode()
        + f"event: {entry.kind}\ndata: ".encode()
        + to_json({"time": entry.time, "data": entry.data}, inf_nan_mode="null")
        + b"\n\n"
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
