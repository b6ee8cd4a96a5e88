"""Sweeps: submit, list, read, change, cancel, resume, delete."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from pydantic import AfterValidator, Field

from api.access import PrincipalDep, ownership_of_new, whose
from api.dependencies import QueryParameters, Service, ServiceDep, id_in_path
from api.openapi import EXAMPLES
from api.problems import BodyTooLarge, MalformedBody, UnsupportedMediaType, refusals
from api.routes.jobs import Cursor
from api.submissions import (
    RESUMPTION,
    IdempotencyKey,
    JsonBody,
    PatchBody,
    SubmittedSweep,
    idempotency,
    parse,
    patch_of,
)
from api.views import Listing, answer, sweep_details, sweep_view
from core.errors import (
    IdempotencyKeyReused,
    JobNotFound,
    QuotaExceeded,
    RecordsUnavailable,
    Rejected,
    SweepFinished,
    SweepNotFinished,
    SweepNotFound,
    TooManySweeps,
)
from core.jobs.job import JOB_ID, Job, UnreadableJob, check_job_id
from core.jobs.patch import JOB_PATCH
from core.jobs.spec import Text
from core.sweeps.actions import cancel_sweep, delete_sweep, patch_sweep, resume_sweep, submit_sweep
from core.sweeps.sweep import Sweep, SweepStatus, Trial
from gaitway.schema import SweepDetails, SweepView

router = APIRouter(tags=["sweeps"])


def _check_sweep_id(text: str) -> str:
    try:
        return check_job_id(text)
    except JobNotFound:
        raise SweepNotFound(text[:64]) from None


SweepId = Annotated[str, id_in_path("A sweep's id."), AfterValidator(_check_sweep_id)]


def _body(schema: str, examples: Mapping[str, Any]) -> dict[str, Any]:
    content = {"schema": {"$ref": f"#/components/schemas/{schema}"}, "examples": examples}
    return {"requestBody": {"required": True, "content": {"application/json": content}}}


class SweepFilters(QueryParameters):
    """Filters of a listing."""

    id: list[Annotated[str, Field(pattern=f"^{JOB_ID}$")]] = Field(
        [], max_length=200, description="Only these; repeatable.", examples=[[]]
    )
    status: SweepStatus | None = None
    owner: Text | None = Field(None, description="A user's name.", examples=[None])
    project: Text | None = Field(None, description="One of your projects.", examples=[None])
    cursor: Cursor | None = Field(None, description="The `next` of an earlier page.")
    limit: int = Field(50, ge=1, le=200)


@router.post(
    "/sweeps",
    status_code=202,
    response_model=SweepDetails,
    openapi_extra=_body("SweepSpec", EXAMPLES),
    response_description="Stored; its trials start within seconds",
    responses=refusals(
        MalformedBody,
        IdempotencyKeyReused,
        TooManySweeps,
        BodyTooLarge,
        UnsupportedMediaType,
        Rejected,
        QuotaExceeded,
        RecordsUnavailable,
    ),
)
def submit(
    spec: SubmittedSweep, key: IdempotencyKey, service: ServiceDep, principal: PrincipalDep
) -> Response:
    """Start a sweep: child jobs whose settings vary, by a grid, at random or as Optuna's samplers say."""
    sweep = submit_sweep(
        spec,
        store=service.store,
        ownership=ownership_of_new(principal, spec.project or spec.job.project, service),
        idempotency=idempotency(key, spec, principal),
    )
    return answer(_details(sweep, service), 202, {"Location": f"/sweeps/{sweep.id}"})


@router.get("/sweeps", response_model=Listing[SweepView], responses=refusals(Rejected, RecordsUnavailable))
def list_sweeps(
    listed: Annotated[SweepFilters, Query()], service: ServiceDep, principal: PrincipalDep
) -> Response:
    """Sweeps, newest first; with accounts your own, and then those of others in your projects."""
    page = service.store.list_sweeps(
        ids=listed.id or None,
        status=listed.status,
        whose=whose(principal, listed.owner, listed.project),
        cursor=listed.cursor,
        limit=listed.limit,
    )
    trials = service.store.trials([sweep.id for sweep in page.sweeps])
    jobs = _jobs([trial for each in trials.values() for trial in each], service)
    now = service.store.now()
    views = [sweep_view(sweep, trials.get(sweep.id, ()), jobs, now) for sweep in page.sweeps]
    return answer(Listing[SweepView](items=views, next=page.next_cursor))


@router.get(
    "/sweeps/{sweep_id}",
    response_model=SweepDetails,
    responses=refusals(SweepNotFound, RecordsUnavailable),
)
def read(sweep_id: SweepId, service: ServiceDep) -> Response:
    """A sweep as it is now, with its trials, the best so far, and the importance of its axes."""
    return answer(_details(service.store.get_sweep(sweep_id), service))


@router.patch(
    "/sweeps/{sweep_id}",
    response_model=SweepDetails,
    openapi_extra=patch_of(JOB_PATCH),
    response_description="The sweep as it is now",
    responses=refusals(
        MalformedBody, SweepNotFound, BodyTooLarge, UnsupportedMediaType, Rejected, RecordsUnavailable
    ),
)
def change(sweep_id: SweepId, body: PatchBody, service: ServiceDep) -> Response:
    """Change a sweep's name, labels and note by a JSON merge patch (RFC 7396), at any time.

    Trials that begin after that get the labels; those that have begun are jobs with labels of their own.
    """
    return answer(_details(patch_sweep(sweep_id, parse(body, JOB_PATCH), store=service.store), service))


@router.post(
    "/sweeps/{sweep_id}/cancel",
    status_code=202,
    response_model=SweepDetails,
    response_description="No trial starts any more; those that run are cancelled and keep their work",
    responses=refusals(SweepNotFound, SweepFinished, RecordsUnavailable),
)
def cancel(sweep_id: SweepId, service: ServiceDep) -> Response:
    """Cancel a sweep and all of its trials. Repeating this changes nothing."""
    return answer(_details(cancel_sweep(sweep_id, store=service.store), service), 202)


@router.post(
    "/sweeps/{sweep_id}/resume",
    status_code=202,
    response_model=SweepDetails,
    openapi_extra=_body("Resumption", {"more trials": {"value": {"budget": {"jobs": 40, "parallel": 4}}}}),
    response_description="It continues; its next trials start within seconds",
    responses=refusals(
        MalformedBody,
        SweepNotFound,
        SweepNotFinished,
        TooManySweeps,
        BodyTooLarge,
        UnsupportedMediaType,
        Rejected,
        RecordsUnavailable,
    ),
)
def resume(sweep_id: SweepId, body: JsonBody, service: ServiceDep) -> Response:
    """Continue a sweep under another budget, which counts the trials that it had. They stay as they are."""
    budget = parse(body, RESUMPTION).budget
    return answer(_details(resume_sweep(sweep_id, budget, store=service.store), service), 202)


@router.delete(
    "/sweeps/{sweep_id}",
    status_code=204,
    responses=refusals(SweepNotFound, SweepNotFinished, RecordsUnavailable),
)
def delete(sweep_id: SweepId, service: ServiceDep) -> None:
    """Delete the record of an ended sweep. Its jobs and their files stay; the label `sweep` finds them."""
    delete_sweep(sweep_id, store=service.store)


def _details(sweep: Sweep, service: Service) -> SweepDetails:
    trials = service.store.trials([sweep.id]).get(sweep.id, ())
    return sweep_details(sweep, trials, _jobs(trials, service), service.store.now())


def _jobs(trials: Sequence[Trial], service: Service) -> Mapping[str, Job | UnreadableJob]:
    """The jobs of trials that have not ended; the record of the others says all about them."""
    going = [trial.job for trial in trials if trial.outcome is None and trial.job is not None]
    return service.store.jobs_of(going)
