"""Many jobs at once: cancels or deletes those that a list or a filter names, in a transaction each."""

from collections.abc import Callable, Sequence
from time import monotonic
from typing import Any, Self

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field, TypeAdapter, model_validator

from api.access import Forbidden, PrincipalDep, actor_of, check_job
from api.dependencies import Service, ServiceDep
from api.problems import BodyTooLarge, MalformedBody, UnsupportedMediaType, refusals
from api.routes.jobs import Cursor, JobFilters, naming_those_seen
from api.submissions import JsonBody, body_of, parse
from api.views import Listing, answer
from core.accounts.principal import Principal
from core.documents import Strict
from core.errors import GaitwayError, Problem, RecordsUnavailable, Rejected, Unavailable
from core.jobs.ending import cancel_in_record, delete_in_record, forget_dispatches
from core.jobs.job import Job
from core.jobs.spec import JobId
from core.jobs.status import JobStatus
from gaitway.schema import OutcomeView

router = APIRouter(tags=["jobs"])

MOST_AT_ONCE = 200
# A client waits for half a minute.
_LONGEST_S = 20.0


class Chosen(Strict):
    """Jobs by their ids, or those that a filter of `GET /jobs` matches, in its order."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"filter": {"label": ["sweep:3"]}}]})

    jobs: list[JobId] | None = Field(default=None, min_length=1, max_length=MOST_AT_ONCE)
    filter: JobFilters | None = Field(default=None, description="As in the address of `GET /jobs`.")
    cursor: Cursor | None = Field(
        default=None, description="The `next` of the answer before, for what else the filter matches."
    )

    @model_validator(mode="after")
    def _says_which(self) -> Self:
        if (self.jobs is None) == (self.filter is None):
            raise ValueError("give either `jobs` or `filter`")
        if self.filter is not None and not self.filter.model_dump(exclude_defaults=True):
            raise ValueError("an empty `filter` matches all jobs: say which")
        if self.jobs is not None and self.cursor is not None:
            raise ValueError("a `cursor` goes with a `filter`, not with `jobs`")
        return self


_CHOSEN: TypeAdapter[Chosen] = TypeAdapter(Chosen)
_DOCUMENTED: dict[str, Any] = {
    "response_model": Listing[OutcomeView],
    "openapi_extra": body_of(_CHOSEN),
    "response_description": "What became of each job; `next` if the filter matches more of them",
    "responses": refusals(
        MalformedBody, Forbidden, BodyTooLarge, UnsupportedMediaType, Rejected, RecordsUnavailable
    ),
}


class NotReached(Unavailable):
    """A request has some seconds; jobs that come after that are left as they are."""

    code = "not-reached"
    title = "The request had no time for this job"


@router.post("/jobs/cancel", **_DOCUMENTED)
def cancel_jobs(body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep) -> Response:
    """Cancel up to 200 jobs. Each is answered alone, as `cancelled`, `cancelling` or `refused` and why.

    One that is refused stops no other; repeating it changes nothing.
    """
    cancelled = list[Job]()

    def cancel(job_id: str) -> str:
        job = cancel_in_record(job_id, store=service.store)
        cancelled.extend([job] * (job.status == JobStatus.CANCELLED))
        return job.status

    try:
        return answer(_each(body, "job.cancelled", cancel, request, service, principal))
    finally:
        forget_dispatches(cancelled, service.queue)


@router.post("/jobs/delete", **_DOCUMENTED)
def delete_jobs(body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep) -> Response:
    """Delete up to 200 ended jobs permanently. Each is answered alone, as `deleted` or `refused` and why.

    One that is refused stops no other. The files are removed within minutes.
    """

    def delete(job_id: str) -> str:
        with naming_those_seen(principal, service):
            delete_in_record(job_id, store=service.store)
        return "deleted"

    return answer(_each(body, "job.deleted", delete, request, service, principal))


def _each(
    body: bytes,
    action: str,
    act: Callable[[str], str],
    request: Request,
    service: Service,
    principal: Principal,
) -> Listing[OutcomeView]:
    """What became of each chosen job. action: of the audit log."""
    chosen = parse(body, _CHOSEN)
    job_ids, cursor = _ids(chosen, service, principal)

    def checked(job_id: str) -> str:
        check_job(job_id, principal, service)
        result = act(job_id)
        # At once: what follows may fail.
        if service.authenticator is not None:
            service.audit_log.add(actor_of(principal, request), action, f"job {job_id}")
        return result

    outcomes = outcomes_of(job_ids, checked, monotonic() + _LONGEST_S)
    return Listing[OutcomeView](items=outcomes, next=cursor)


def _ids(chosen: Chosen, service: Service, principal: Principal) -> tuple[Sequence[str], str | None]:
    if chosen.filter is None:
        return list(dict.fromkeys(chosen.jobs or ())), None
    try:
        query = chosen.filter.query(principal)
    except Rejected as error:
        problems = [Problem(f"/filter{one.pointer}", one.detail) for one in error.problems]
        raise Rejected(error.detail, problems) from None
    page = service.store.list(query, cursor=chosen.cursor, limit=MOST_AT_ONCE, brief=True)
    return [job.id for job in page.jobs], page.next_cursor


def outcomes_of(job_ids: Sequence[str], act: Callable[[str], str], until: float) -> Sequence[OutcomeView]:
    """What became of each job. until: when to leave the rest, by the monotonic clock.

    An outage leaves the rest, too. Raises Unavailable where nothing was done before it.
    """
    outcomes = list[OutcomeView]()
    for job_id in job_ids:
        try:
            if monotonic() >= until:
                raise NotReached("The request had no time left for this job: ask again.")
            outcomes.append(OutcomeView(job=job_id, result=act(job_id)))
        except Unavailable as error:
            if not outcomes:
                raise
            return [*outcomes, *(_refused(rest, error) for rest in job_ids[len(outcomes) :])]
        except GaitwayError as error:
            outcomes.append(_refused(job_id, error))
    return outcomes


def _refused(job_id: str, error: GaitwayError) -> OutcomeView:
    return OutcomeView(job=job_id, result="refused", code=error.code, message=error.detail)
