"""A job for others: its whole specification, a zip to run it again, a report and a picture to look at."""

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import Field
from starlette.responses import StreamingResponse

from api.dependencies import JobId, Parameters, ServiceDep
from api.files import PiecesResponse
from api.problems import refusals
from api.sharing.curve_svg import RETURNS, curve_svg, lines_of
from api.sharing.export import export, first_read
from api.sharing.report import POLICY, open_report
from api.sharing.zip_stream import zip_stream
from core.errors import JobNotFound, JobUnreadable, RecordsUnavailable, Rejected, StorageUnavailable
from core.jobs.filled_in import filled_in
from core.jobs.spec import Text

router = APIRouter(tags=["sharing"])

_REFUSALS = refusals(JobNotFound, JobUnreadable, RecordsUnavailable, StorageUnavailable)
_CURVE_POINTS = 600
# A report and a picture run nothing and reach nothing, also when they are opened from here.
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": f"{POLICY}; sandbox",
    "X-Content-Type-Options": "nosniff",
}


class Pictured(Parameters):
    """The metrics of a picture."""

    metric: list[Text] = Field([], max_length=100, description="By default the return; repeatable.")


@router.get(
    "/jobs/{job_id}/specification",
    responses=refusals(JobNotFound, JobUnreadable, RecordsUnavailable),
    response_description="A specification that can be submitted again",
)
def read_specification(job_id: JobId, service: ServiceDep) -> dict[str, Any]:
    """The specification with all that defaults fill in: every option, and every hyperparameter.

    The hyperparameters are those of the newest attempt; before there is one, those that a CPU would get, or a
    GPU where the job asks for one.
    """
    return filled_in(service.store.get(job_id), service.store)


@router.get(
    "/jobs/{job_id}/export",
    response_class=Response,
    responses={
        200: {
            "description": "The zip",
            "content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}},
        },
        **_REFUSALS,
    },
)
def export_job(job_id: JobId, service: ServiceDep) -> Response:
    """All that is needed to run the job again elsewhere, as a zip that is made while it is sent.

    The specification with its defaults filled in, versions, attempts, metrics, log, the newest checkpoint and
    video, every other file, and the user's own model. `contents.json` lists them with their hashes, and names
    what is missing and why. A job that runs is exported as it stands. If the stores become unavailable in the
    middle, the connection breaks, and the zip has no end.
    """
    members = first_read(export(service.store.get(job_id), service))
    headers = {"Content-Disposition": f'attachment; filename="{job_id}.zip"', "Cache-Control": "no-store"}
    return StreamingResponse(zip_stream(members), headers=headers, media_type="application/zip")


@router.get(
    "/jobs/{job_id}/report.html",
    response_class=Response,
    responses={
        200: {"description": "The report", "content": {"text/html": {"schema": {"type": "string"}}}},
        **_REFUSALS,
    },
)
def report_job(job_id: JobId, service: ServiceDep) -> Response:
    """A report on the job for people: one HTML file with curves, video, settings, versions, attempts and the
    end of the log. It needs no network, so that it can be sent and kept. Only its replay runs scripts."""
    job = service.store.get(job_id)
    opened = ExitStack()
    report = opened.enter_context(open_report(job, service))
    pieces: Iterator[bytes] = report.pieces()
    scripts = " allow-scripts" * (report.policy != POLICY)
    headers = {
        **_HEADERS,
        "Content-Security-Policy": f"{report.policy}; sandbox{scripts}",
        "Content-Disposition": f'inline; filename="{job_id}.html"',
        "Content-Type": "text/html; charset=utf-8",
    }
    return PiecesResponse(pieces, opened, 200, headers)


@router.get(
    "/jobs/{job_id}/curve",
    response_class=Response,
    responses={
        200: {"description": "The picture", "content": {"image/svg+xml": {"schema": {"type": "string"}}}},
        **refusals(JobNotFound, Rejected, RecordsUnavailable, StorageUnavailable),
    },
)
def draw_curve(job_id: JobId, asked: Annotated[Pictured, Query()], service: ServiceDep) -> Response:
    """Metrics over steps as a picture in SVG, for a notebook or a page elsewhere."""
    names = tuple(asked.metric) or RETURNS
    with service.curves.curves(job_id, frozenset(names)) as (curves, _):
        rows = curves.thinned(frozenset(names), _CURVE_POINTS, None, None)
    title = "Metrics" if asked.metric else "Return"
    return Response(curve_svg(lines_of(rows, names), title), headers=_HEADERS, media_type="image/svg+xml")
