"""Jobs: submit, list, read, change, cancel, delete."""

import re
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, Query, Response
from pydantic import Field

from api.access import PrincipalDep, ownership_of_new, whose
from api.dependencies import CorrelationId, JobId, QueryParameters, Service, ServiceDep
from api.problems import BodyTooLarge, MalformedBody, UnsupportedMediaType, refusals
from api.shared_reads import max_age_s
from api.submissions import EXAMPLES, IdempotencyKey, PatchBody, Submitted, idempotency, parse, patch_of
from api.views import JobsListing, answer, job_view
from core.accounts.principal import Principal
from core.errors import (
    IdempotencyKeyReused,
    JobFinished,
    JobInUse,
    JobNotFinished,
    JobNotFound,
    JobUnreadable,
    Problem,
    QuotaExceeded,
    RecordsUnavailable,
    Rejected,
    StorageUnavailable,
)
from core.jobs.ending import cancel, delete
from core.jobs.job import JOB_ID, Job, UnreadableJob
from core.jobs.patch import JOB_PATCH
from core.jobs.quotas import check_quotas
from core.jobs.resolved import filled_in
from core.jobs.sorting import COLUMNS, LABEL, sort_by
from core.jobs.spec import JobKind, Text
from core.jobs.status import JobStatus
from core.jobs.store import FOLDED, NO_SWEEP, JobQuery
from core.jobs.submission import check_notify, new_job, submit
from core.jobs.workers import WorkerInfo
from gaitway.schema import JobView

router = APIRouter(tags=["jobs"])

_SCHEMA = {"$ref": "#/components/schemas/JobSpec"}
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": _SCHEMA, "examples": EXAMPLES}},
    }
}
_LABEL = r"([A-Za-z0-9_.-]{1,63})[:=]([^\x00]{0,200})"


# These patterns only document the format; the checks elsewhere give better messages.
Label = Annotated[str, Field(json_schema_extra={"pattern": f"^{_LABEL}$"})]
_CURSOR = f"(others-)?{JOB_ID}|others"
Cursor = Annotated[str, Field(max_length=100, json_schema_extra={"pattern": f"^({_CURSOR})$"})]
# That of a sorted list has the last job's value.
SortedCursor = Annotated[
    str, Field(max_length=2000, json_schema_extra={"pattern": f"^({_CURSOR}|sorted-[A-Za-z0-9_-]+)$"})
]
SortColumn = Annotated[
    str,
    Field(
        max_length=80,
        json_schema_extra={"pattern": f"^({'|'.join(COLUMNS)}|{LABEL}[A-Za-z0-9_.-]{{1,63}})$"},
    ),
]
SweepChoice = Annotated[
    str, Field(max_length=100, json_schema_extra={"pattern": f"^({NO_SWEEP}|{FOLDED}|{JOB_ID})$"})
]
_SORT = (
    "A column: "
    + "; ".join(f"`{name}`, {what}" for name, what in COLUMNS.items())
    + "; or `label:KEY`. What has no value comes last."
)
_SWEEP = (
    f"A sweep's id: its trials alone. `{NO_SWEEP}`: no trials. `{FOLDED}`: of the trials of a sweep that "
    "match only the first in this list, whose `sweep` stands for all of them."
)


class JobFilters(QueryParameters):
    """Which jobs; each filter that is given must match."""

    status: JobStatus | None = None
    kind: JobKind | None = None
    environment: Text | None = Field(None, examples=["ant"])
    name: Text | None = Field(None, description="The whole name.")
    search: Text | None = Field(
        None,
        description="A part of the name, of the note or of the environment's id, in any case.",
        examples=["first"],
    )
    owner: Text | None = Field(None, description="A user's name.", examples=[None])
    project: Text | None = Field(None, description="One of your projects.", examples=[None])
    label: list[Label] = Field([], max_length=64, description="`key:value` or `key=value`; repeatable.")

    def query(self, principal: Principal) -> JobQuery:
        """Raises Rejected."""
        return JobQuery(
            whose=whose(principal, self.owner, self.project),
            status=self.status,
            kind=self.kind,
            environment=self.environment,
            name=self.name,
            search=self.search or None,
            labels=dict(_label(text) for text in self.label),
        )


class JobListing(JobFilters):
    """A page of those that match, in some order."""

    sweep: SweepChoice | None = Field(None, description=_SWEEP)
    sort: SortColumn | None = Field(None, description=_SORT, examples=["return"])
    order: Literal["asc", "desc"] | None = Field(
        None, description="Of `sort`; `desc`, the greatest first, by default."
    )
    cursor: SortedCursor | None = Field(None, description="The `next` of an earlier page.")
    limit: int = Field(50, ge=1, le=200)

    def query(self, principal: Principal) -> JobQuery:
        if self.order is not None and self.sort is None:
            sentence = "`order` is that of `sort`: say by which column."
            raise Rejected(sentence, [Problem("/order", sentence)])
        sweep = None if self.sweep is None else _sweep(self.sweep)
        sort = None if self.sort is None else sort_by(self.sort, descending=self.order != "asc")
        return super().query(principal).model_copy(update={"sweep": sweep, "sort": sort})


@router.post(
    "/jobs",
    status_code=202,
    response_model=JobView,
    openapi_extra=_BODY,
    response_description="Queued; the job will not be lost",
    responses=refusals(
        MalformedBody,
        IdempotencyKeyReused,
        BodyTooLarge,
        UnsupportedMediaType,
        Rejected,
        QuotaExceeded,
        RecordsUnavailable,
    ),
)
def submit_job(
    spec: Submitted,
    key: IdempotencyKey,
    correlation_id: CorrelationId,
    service: ServiceDep,
    principal: PrincipalDep,
) -> Response:
    """Queue a training or a rollout."""
    job = submit(
        spec,
        store=service.store,
        queue=service.queue,
        ownership=ownership_of_new(principal, spec.project, service),
        readable=principal.readable,
        idempotency=idempotency(key, spec, principal),
        acknowledge=service.acknowledgements.add,
        correlation_id=correlation_id,
    )
    return answer(job_view(job), 202, {"Location": f"/jobs/{job.id}"})


@router.post(
    "/jobs/check",
    openapi_extra=_BODY,
    response_description="It would be queued as this specification",
    responses=refusals(
        MalformedBody, BodyTooLarge, UnsupportedMediaType, Rejected, QuotaExceeded, RecordsUnavailable
    ),
)
def check_job(spec: Submitted, service: ServiceDep, principal: PrincipalDep) -> dict[str, Any]:
    """Refuse what a submission would be refused for, and store nothing.

    Otherwise the specification with all that defaults fill in, which can be submitted.
    """
    ownership = ownership_of_new(principal, spec.project, service)
    check_notify(spec, ownership.project, service.store)
    job = new_job(spec, service.store, ownership, principal.readable)
    check_quotas(spec, ownership, service.store, with_queue=True)
    return filled_in(job, service.store)


@router.get("/jobs", response_model=JobsListing, responses=refusals(Rejected, RecordsUnavailable))
def list_jobs(
    listed: Annotated[JobListing, Query()],
    service: ServiceDep,
    principal: PrincipalDep,
    cache_control: Annotated[str, Header(max_length=200)] = "",
) -> Response:
    """Jobs, newest first; with accounts your own, and then those of others in your projects.

    With `sort`, all of them in the order of a column. Sorted lists are of the newest 100,000 jobs that
    you may see, under `owner` and `project`, or of all trials of a sweep; other filters choose among these.
    Where older ones are left out, `of_newest` says so. A job whose value changes while you turn pages may be
    missing, or come twice.

    Each has its newest ten attempts, without `details` and with messages of up to 1,000 characters, and its
    newest ten files of each role, without `metadata` of more than 1,000 bytes: `GET /jobs/{job_id}` has all.
    A page whose jobs are very long has fewer than `limit`.

    With `Cache-Control: max-age=N`, the answer may be the one that another client got in the last N seconds.
    """
    query, age_s = listed.query(principal), max_age_s(cache_control)
    # With whose jobs they may be: two users have different answers to one address.
    question = f"{query.model_dump_json()} {listed.cursor} {listed.limit}"
    found = service.lists.find(question, age_s) if age_s else None
    if found is None:
        page = service.store.list(query, cursor=listed.cursor, limit=listed.limit, brief=True)
        workers = _workers(page.jobs, service)
        turns = None if workers is None else service.turns.now(workers)
        sweeps = service.store.sweeps_of([job.id for job in page.jobs])
        views = [job_view(job, workers, turns, sweeps.get(job.id)) for job in page.jobs]
        listing = JobsListing(items=views, next=page.next_cursor, of_newest=page.of_newest)
        found = listing.model_dump_json().encode()
        service.lists.keep(question, found)
    return Response(found, media_type="application/json")


@router.get("/jobs/{job_id}", response_model=JobView, responses=refusals(JobNotFound, RecordsUnavailable))
def read_job(job_id: JobId, service: ServiceDep) -> Response:
    """A job as it is now."""
    return answer(_view(service.store.find(job_id), service))


@router.patch(
    "/jobs/{job_id}",
    response_model=JobView,
    openapi_extra=patch_of(JOB_PATCH),
    response_description="The job as it is now",
    responses=refusals(
        MalformedBody,
        JobNotFound,
        JobUnreadable,
        BodyTooLarge,
        UnsupportedMediaType,
        Rejected,
        RecordsUnavailable,
    ),
)
def change_job(job_id: JobId, body: PatchBody, service: ServiceDep) -> Response:
    """Change a job's name, labels and note by a JSON merge patch (RFC 7396), at any time, also while it runs.

    They change nothing of what it does. `GET /jobs/{job_id}/specification` and exports have the new ones.
    """
    return answer(_view(service.store.patch(job_id, parse(body, JOB_PATCH)), service))


@router.post(
    "/jobs/{job_id}/cancel",
    status_code=202,
    response_model=JobView,
    response_description="The job stops as soon as its results so far are saved",
    responses={
        200: {"model": JobView, "description": "The job is cancelled"},
        **refusals(JobNotFound, JobFinished, JobUnreadable, RecordsUnavailable),
    },
)
def cancel_job(job_id: JobId, service: ServiceDep) -> Response:
    """Stop a job and keep its checkpoint, metrics and video up to now. Repeating this changes nothing."""
    job = cancel(job_id, store=service.store, queue=service.queue)
    return answer(job_view(job), 200 if job.status.is_final else 202)


@router.delete(
    "/jobs/{job_id}",
    status_code=204,
    responses=refusals(JobNotFound, JobNotFinished, JobInUse, RecordsUnavailable, StorageUnavailable),
)
def delete_job(job_id: JobId, service: ServiceDep, principal: PrincipalDep) -> None:
    """Delete an ended job and its files permanently."""
    with naming_those_seen(principal, service):
        delete(job_id, store=service.store, objects=service.objects)


@contextmanager
def naming_those_seen(principal: Principal, service: Service) -> Generator[None]:
    """Raise a JobInUse without the names of jobs that the principal does not see.

    A sweep uses jobs of its own project alone, so whoever sees the job sees the sweep.
    """
    try:
        yield
    except JobInUse as error:
        needed = service.store.jobs_of(error.jobs)
        seen = [borrower for borrower, job in needed.items() if principal.sees(job.project)]
        raise JobInUse(error.job, seen, error.sweeps, len(error.jobs) - len(seen)) from None


def _view(job: Job | UnreadableJob, service: Service) -> JobView:
    """With its sweep and, while it is queued, its turn."""
    workers = _workers([job], service)
    turns = None if workers is None else service.turns.now(workers)
    return job_view(job, workers, turns, service.store.sweeps_of([job.id]).get(job.id))


def _workers(jobs: Sequence[Job | UnreadableJob], service: Service) -> Sequence[WorkerInfo] | None:
    """The present workers, if one of these jobs is queued."""
    is_waiting = any(job.status == JobStatus.QUEUED for job in jobs)
    return service.store.workers() if is_waiting else None


def _sweep(text: str) -> str:
    if text in (NO_SWEEP, FOLDED) or re.fullmatch(JOB_ID, text):
        return text
    sentence = f"`sweep` is a sweep's id, `{NO_SWEEP}` or `{FOLDED}`, not {text[:80]!r}."
    raise Rejected(sentence, [Problem("/sweep", sentence)])


def _label(text: str) -> tuple[str, str]:
    found = re.fullmatch(_LABEL, text)
    if found is None:
        detail = (
            f"`label` must be key:value, with a key of letters, digits, `_`, `.` and `-`, not {text[:80]!r}."
        )
        raise Rejected(detail, [Problem("/label", detail)])
    return found[1], found[2]
