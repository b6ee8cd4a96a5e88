"""A job's events and the output of its training process, live."""

from collections.abc import AsyncIterator
from typing import Annotated, Literal

from anyio import to_thread
from fastapi import APIRouter, Header, Query, Request, Response
from pydantic import Field
from starlette.responses import StreamingResponse

from api.access import while_allowed
from api.dependencies import EntryId, JobId, QueryParameters, ServiceDep
from api.problems import refusals
from api.streams import HEADERS, MEDIA_TYPE, Follower, event_stream, look
from core.errors import JobNotFound, RecordsUnavailable, Rejected, StorageUnavailable
from core.jobs.store import entry_number

router = APIRouter(tags=["jobs"])

_EXAMPLE = 'id: 7\nevent: status\ndata: {"time":"2026-11-20T09:00:00Z","data":{"status":"running"}}\n\n'

EventKind = Literal["status", "progress", "metrics", "artifact", "phase", "note"]
_HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "X-Accel-Buffering": "no"}


class After(QueryParameters):
    """after: the id of the last event seen; the header Last-Event-ID means the same and takes precedence."""

    after: EntryId = ""
    kind: list[EventKind] = Field(
        [], max_length=6, description="Only events of these kinds, and the end; repeatable."
    )
    follow: bool = Field(True, description="false: only the events so far.")


@router.get(
    "/jobs/{job_id}/events",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "Events of the kinds status, progress, metrics, artifact, phase and note; the "
            "last one is the job's final status. A comment is sent after every 15 seconds of silence.",
            "content": {MEDIA_TYPE: {"example": _EXAMPLE}},
        },
        204: {"description": "The job has ended and all its events were seen: do not reconnect"},
        **refusals(JobNotFound, Rejected, RecordsUnavailable, StorageUnavailable),
    },
)
async def follow_events(
    job_id: JobId,
    asked: Annotated[After, Query()],
    service: ServiceDep,
    request: Request,
    last_event_id: Annotated[EntryId, Header(alias="Last-Event-ID")] = "",
) -> Response:
    """A job's events as server-sent events until it ends; with `Last-Event-ID`, only those after that one."""
    after = entry_number(last_event_id or asked.after)
    job, has_more = await to_thread.run_sync(look, service, job_id, "events", after)
    if after and job.status.is_final and not has_more:
        return Response(status_code=204)
    stream = event_stream(Follower(service, job, "events", after), asked.kind, follow=asked.follow)
    pieces = while_allowed(stream, request, service)
    return StreamingResponse(pieces, headers=HEADERS, media_type=MEDIA_TYPE)


class LogQuery(QueryParameters):
    """follow: continue until the job ends."""

    follow: bool = False


@router.get(
    "/jobs/{job_id}/logs",
    response_class=StreamingResponse,
    responses={
        200: {"description": "Lines of text", "content": {"text/plain": {"example": "compiled in 12.1 s\n"}}},
        **refusals(JobNotFound, Rejected, RecordsUnavailable, StorageUnavailable),
    },
)
async def read_logs(
    job_id: JobId, asked: Annotated[LogQuery, Query()], service: ServiceDep, request: Request
) -> Response:
    """The log of all attempts so far; with `follow=true` also new lines until the job ends."""
    job, _ = await to_thread.run_sync(look, service, job_id, "logs")
    stream = _text(Follower(service, job, "logs", 0), follow=asked.follow)
    pieces = while_allowed(stream, request, service)
    return StreamingResponse(pieces, headers=_HEADERS, media_type="text/plain; charset=utf-8")


async def _text(follower: Follower, *, follow: bool) -> AsyncIterator[bytes]:
    async for page in follower.coming() if follow else follower.present():
        if page:
            yield "".join(f"{entry.data.get('text', '')}\n" for entry in page).encode("utf-8", "replace")
