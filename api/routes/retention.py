"""What a project keeps of its ended jobs: the rules, shown before they are applied."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import Field, TypeAdapter

from api.access import PrincipalDep, actor_of
from api.dependencies import QueryParameters, ServiceDep
from api.problems import MalformedBody, UnsupportedMediaType, refusals
from api.routes.accounts import ProjectName, body_of
from api.submissions import JsonBody, parse
from core.accounts.principal import Principal
from core.errors import ProjectNotFound, RecordsUnavailable, Rejected, RetentionNeeded
from core.jobs import removal
from core.jobs.retention import Removal, Retention, RetentionRules, Verdict, check_rules
from gaitway.schema import (
    NeededView,
    RemovalView,
    RemovedRoleView,
    RetentionPreviewView,
    RetentionView,
)

router = APIRouter(tags=["projects"])

# Jobs that need one job.
_MOST_NAMED = 5
_RULES = TypeAdapter(RetentionRules)
_REFUSED = (MalformedBody, UnsupportedMediaType, Rejected, ProjectNotFound, RecordsUnavailable)


class PreviewQuery(QueryParameters):
    """How much of a preview is named."""

    limit: int = Field(50, ge=1, le=200, description="How many jobs are named, those with most bytes first.")


@router.get("/projects/{project}/retention", responses=refusals(ProjectNotFound, RecordsUnavailable))
def read_retention(project: ProjectName, service: ServiceDep) -> RetentionView:
    """The rules of a project; `set_at` is null where it has none and keeps everything."""
    found = service.store.retention(project)
    return RetentionView(project=project) if found is None else _view(found)


@router.put(
    "/projects/{project}/retention",
    openapi_extra=body_of(_RULES),
    responses=refusals(*_REFUSED, RetentionNeeded),
)
def set_retention(
    project: ProjectName, body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep
) -> RetentionView:
    """Set the rules, in place of those before; they are applied within the hour, and from then on every hour.

    Rules that would remove now what a waiting or running job needs are refused. What such a job needs later
    stays until it has ended.
    """
    rules = parse(body, _RULES)
    check_rules(rules)
    service.store.retention(project)
    removal.check_needed(project, rules, service.store)
    return _view(service.store.set_retention(project, rules, actor_of(principal, request)))


@router.delete(
    "/projects/{project}/retention",
    status_code=204,
    responses=refusals(ProjectNotFound, RecordsUnavailable),
)
def end_retention(
    project: ProjectName, request: Request, service: ServiceDep, principal: PrincipalDep
) -> None:
    """Remove nothing more from this moment on; it is no error if the project has no rules."""
    service.store.end_retention(project, actor_of(principal, request))


@router.post(
    "/projects/{project}/retention/preview",
    openapi_extra=body_of(_RULES),
    responses=refusals(*_REFUSED),
)
def preview_retention(
    project: ProjectName,
    body: JsonBody,
    asked: Annotated[PreviewQuery, Query()],
    service: ServiceDep,
    principal: PrincipalDep,
) -> RetentionPreviewView:
    """What these rules would remove now, and what stays because others need it. Nothing changes."""
    rules = parse(body, _RULES)
    check_rules(rules)
    service.store.retention(project)
    found = removal.preview(project, rules, service.store, most=asked.limit)
    return RetentionPreviewView(
        project=project,
        jobs=found.jobs,
        whole_jobs=found.whole_jobs,
        files=found.files,
        bytes=found.size,
        roles=tuple(
            RemovedRoleView(role=role, files=one.files, bytes=one.size) for role, one in found.roles.items()
        ),
        largest=tuple(_removal_view(one) for one in found.largest),
        needed=tuple(_needed_view(one, principal) for one in found.needed),
        num_needed=found.num_needed,
        pinned=found.pinned,
    )


def _view(retention: Retention) -> RetentionView:
    return RetentionView(
        project=retention.project,
        **retention.rules.model_dump(),
        set_at=retention.set_at,
        set_by=retention.set_by,
    )


def _removal_view(removal: Removal) -> RemovalView:
    return RemovalView(
        job=removal.job.id,
        name=removal.job.name,
        owner=removal.job.owner,
        whole=removal.is_whole,
        rules=tuple(removal.files),
        files=removal.num_files,
        bytes=removal.num_bytes,
    )


def _needed_view(verdict: Verdict, principal: Principal) -> NeededView:
    seen = [need.job for need in verdict.needs if principal.sees(need.project)]
    return NeededView(
        job=verdict.job.id,
        name=verdict.job.name,
        needed_by=tuple(seen[:_MOST_NAMED]),
        num_needed_by=len(verdict.needs),
        sweep=verdict.sweep,
    )
