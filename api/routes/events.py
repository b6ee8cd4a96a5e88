"""A job's events, live."""

from typing import Annotated, Literal

from anyio import to_thread
from fastapi import APIRouter, Header, Query, Response
from pydantic import Field
from starlette.responses import StreamingResponse

from api import sse
from api.dependencies import EntryId, JobId, Parameters, ServiceDep
from api.following import Follower, look
from api.problems import refusals
from core.errors import JobNotFound, RecordsUnavailable, Rejected, StorageUnavailable
from core.jobs.store import entry_number

router = APIRouter(tags=["jobs"])

_EXAMPLE = 'id: 7\nevent: status\ndata: {"time":"2026-11-20T09:00:00Z","data":{"status":"running"}}\n\n'

EventKind = Literal["status", "progress", "metrics", "artifact", "phase", "note"]


class After(Parameters):
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
            "content": {sse.MEDIA_TYPE: {"example": _EXAMPLE}},
        },
        204: {"description": "The job has ended and all its events were seen: do not reconnect"},
        **refusals(JobNotFound, Rejected, RecordsUnavailable, StorageUnavailable),
    },
)
async def follow_events(
    job_id: JobId,
    asked: Annotated[After, Query()],
    service: ServiceDep,
    last_event_id: Annotated[EntryId, Header(alias="Last-Event-ID")] = "",
) -> Response:
    """A job's events as server-sent events until it ends; with `Last-Event-ID`, only those after that one."""
    after = entry_number(last_event_id or asked.after)
    job, has_more = await to_thread.run_sync(look, service, job_id, "events", after)
    if after and job.status.is_final and not has_more:
        return Response(status_code=204)
    stream = sse.event_stream(Follower(service, job, "events", after), asked.kind, follow=asked.follow)
    return StreamingResponse(stream, headers=sse.HEADERS, media_type=sse.MEDIA_TYPE)
