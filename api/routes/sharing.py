"""A job for others: its whole specification, a zip to run it again, and a report to look at."""

from collections.abc import Iterator
from contextlib import ExitStack
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Query, Request, Response
from pydantic import Field
from starlette.responses import StreamingResponse

from api.access import PrincipalDep, ownership_of_new
from api.dependencies import JobId, QueryParameters, Service, ServiceDep
from api.files import PiecesResponse
from api.problems import BodyTooLarge, TooManyImports, UnsupportedMediaType, refusals
from api.sharing.archive import open_archive
from api.sharing.export import export, first_read, zip_stream
from api.sharing.importing import read_run
from api.sharing.report import POLICY, open_report
from api.submissions import IdempotencyKey, Upload, receiving
from api.views import job_view
from core.accounts.principal import AccountName, Ownership, Principal
from core.errors import (
    BadExport,
    IdempotencyKeyReused,
    JobNotFound,
    JobUnreadable,
    QuotaExceeded,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
)
from core.jobs.job import Job
from core.jobs.quotas import check_bytes
from core.jobs.resolved import filled_in
from core.jobs.store import Idempotency
from core.jobs.submission import import_run
from gaitway.schema import JobView

router = APIRouter(tags=["sharing"])

_REFUSALS = refusals(JobNotFound, JobUnreadable, RecordsUnavailable, StorageUnavailable)
# A report runs nothing but the viewers of its curves and replay, and reaches nothing, also when it is
# opened from here.
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": f"{POLICY}; sandbox",
    "X-Content-Type-Options": "nosniff",
}


_ZIP_TYPES = ("application/zip", "application/x-zip-compressed")
_IMPORTS_AT_ONCE = 2
_ZIP_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            _ZIP_TYPES[0]: {
                "schema": {
                    "type": "string",
                    "format": "binary",
                    "description": "As `GET /jobs/{job_id}/export` gives it.",
                }
            }
        },
    }
}


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


class ImportParameters(QueryParameters):
    """project: whose members see the job."""

    project: AccountName | None = Field(
        None, description="Where it belongs; with one project of your own you need not say it."
    )


@router.post(
    "/jobs/import",
    status_code=201,
    response_model=JobView,
    openapi_extra=_ZIP_BODY,
    response_description="The job, which has ended; others may resume from it",
    responses=refusals(
        IdempotencyKeyReused,
        BodyTooLarge,
        UnsupportedMediaType,
        TooManyImports,
        BadExport,
        Rejected,
        QuotaExceeded,
        RecordsUnavailable,
        StorageUnavailable,
    ),
)
async def import_job(
    request: Request,
    sent: Annotated[ImportParameters, Query()],
    key: IdempotencyKey,
    service: ServiceDep,
    principal: PrincipalDep,
) -> Response:
    """Make an ended job of an export, of this service or another: others resume from it, and roll it out.

    Its files, metrics and log are there under a new id, and `imported_from` says where it was run. A job that
    was exported before its end is `cancelled`, with the reason `exported_unfinished`.
    """
    said = request.headers.get("content-type", "")
    if said.partition(";")[0].strip().lower() not in _ZIP_TYPES:
        raise UnsupportedMediaType(said, what="an export", accepted=_ZIP_TYPES[:1])
    ownership = await run_sync(ownership_of_new, principal, sent.project, service)
    if service.num_imports >= _IMPORTS_AT_ONCE:
        raise TooManyImports(_IMPORTS_AT_ONCE)
    if key is None:  # A key may be that of an import that is there already.
        await run_sync(check_bytes, ownership, service.store)
    service.num_imports += 1
    try:
        async with receiving(request, service.settings.max_import_bytes) as upload:
            job = await run_sync(_import, upload, key, ownership, service, principal)
    finally:
        service.num_imports -= 1
    headers = {"Location": f"/jobs/{job.id}"}
    return Response(job_view(job).model_dump_json(), 201, headers, media_type="application/json")


def _import(
    upload: Upload, key: str | None, ownership: Ownership, service: Service, principal: Principal
) -> Job:
    idempotency = None if key is None else Idempotency(key, upload.sha256, principal.user)
    if idempotency is not None and (known := service.store.remembered(idempotency)) is not None:
        return known
    with open_archive(upload.path, service.settings.max_import_bytes) as archive:
        run = read_run(archive, service, ownership, principal.readable)
        check_bytes(ownership, service.store, sum(file.artifact.size for file in run.files))
        objects = service.patient or service.objects
        return import_run(run, store=service.store, objects=objects, idempotency=idempotency)


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
    end of the log. It needs no network, so that it can be sent and kept. Only its curves and its replay run
    scripts."""
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
