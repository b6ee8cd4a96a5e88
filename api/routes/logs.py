"""The output of the training process."""

from collections.abc import AsyncIterator
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Query, Response
from starlette.responses import StreamingResponse

from api.dependencies import JobId, Parameters, ServiceDep
from api.following import Follower, look
from api.problems import refusals
from core.errors import JobNotFound, RecordsUnavailable, Rejected, StorageUnavailable

router = APIRouter(tags=["jobs"])

_HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "X-Accel-Buffering": "no"}


class Lines(Parameters):
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
async def read_logs(job_id: JobId, asked: Annotated[Lines, Query()], service: ServiceDep) -> Response:
    """The log of all attempts so far; with `follow=true` also new lines until the job ends."""
    job, _ = await to_thread.run_sync(look, service, job_id, "logs")
    stream = _text(Follower(service, job, "logs", 0), follow=asked.follow)
    return StreamingResponse(stream, headers=_HEADERS, media_type="text/plain; charset=utf-8")


async def _text(follower: Follower, *, follow: bool) -> AsyncIterator[bytes]:
    async for page in follower.coming() if follow else follower.present():
        if page:
            yield "".join(f"{entry.data.get('text', '')}\n" for entry in page).encode("utf-8", "replace")
