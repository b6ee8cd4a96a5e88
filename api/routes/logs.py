"""What the training process printed."""

from collections.abc import AsyncIterator
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from starlette.responses import StreamingResponse

from api.dependencies import JobId, Parameters, Service, ServiceDep
from api.files import file_response
from api.following import Follower
from api.problems import refusals
from core.errors import JobNotFound, RecordsUnavailable, Rejected
from core.jobs.job import Job

router = APIRouter(tags=["jobs"])

_HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "X-Accel-Buffering": "no"}


class Lines(Parameters):
    """follow: go on until the job ends."""

    follow: bool = False


@router.get(
    "/jobs/{job_id}/logs",
    response_class=StreamingResponse,
    responses={
        200: {"description": "Lines of text", "content": {"text/plain": {"example": "compiled in 12.1 s\n"}}},
        **refusals(JobNotFound, Rejected, RecordsUnavailable),
    },
)
async def read_logs(
    job_id: JobId, asked: Annotated[Lines, Query()], service: ServiceDep, request: Request
) -> Response:
    """The log so far, of every attempt; with `follow=true` also what is still to come."""
    job, has_lines = await to_thread.run_sync(_look, service, job_id)
    kept = None if has_lines else job.newest("log")
    if kept is not None:  # The feed is gone when the records had to be rebuilt; the file is not.
        return await to_thread.run_sync(file_response, request, kept, service.objects)
    stream = _text(Follower(service, job, "logs", ""), follow=asked.follow)
    return StreamingResponse(stream, headers=_HEADERS, media_type="text/plain; charset=utf-8")


async def _text(follower: Follower, *, follow: bool) -> AsyncIterator[bytes]:
    async for page in follower.pages(to_the_end=follow):
        if page:
            yield "".join(f"{entry.data.get('text', '')}\n" for entry in page).encode("utf-8", "replace")


def _look(service: Service, job_id: str) -> tuple[Job, bool]:
    job = service.store.get(job_id)
    return job, bool(service.store.feed(job_id, "logs", limit=1))
