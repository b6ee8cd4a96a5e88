"""Quotas: what users and projects may have, and what is used of it."""

import re
from typing import Annotated

from fastapi import APIRouter, Path, Request
from pydantic import Field, TypeAdapter

from api.access import PrincipalDep, actor_of
from api.dependencies import Service, ServiceDep
from api.problems import MalformedBody, UnsupportedMediaType, refusals
from api.routes.accounts import AccountsOff, body_of
from api.submissions import JsonBody, parse
from api.views import Listing
from core.accounts.principal import NAME, Principal
from core.documents import Strict
from core.errors import ProjectNotFound, QuotaNotFound, RecordsUnavailable, Rejected, UserNotFound
from core.jobs.quotas import QuotaKind, QuotaUse
from core.jobs.spec import Priority
from core.jobs.turns import Quota
from gaitway.schema import QuotaUseView, QuotaView

router = APIRouter(tags=["quotas"])

_LARGEST = 2**31 - 1
_Name = Annotated[
    str,
    Path(
        description="A user's or a project's name.",
        examples=["default"],
        json_schema_extra={"pattern": f"^{NAME}$"},
    ),
]
_Kind = Annotated[QuotaKind, Path(examples=["project"])]


class NewQuota(Strict):
    """What a user or a project may have. Without a number there is no limit; 0 is none at all.

    weight: of its share where turns are given; with 0 it comes after all others. running, queued: jobs at
    once. gpu_hours: in seven days. bytes: of the files of jobs, of models and of clips. highest_priority: of
    the jobs that they submit.
    """

    weight: float = Field(1.0, ge=0, le=1e6)
    running: int | None = Field(None, ge=0, le=_LARGEST)
    queued: int | None = Field(None, ge=0, le=_LARGEST)
    gpu_hours: float | None = Field(None, ge=0, le=1e9)
    bytes: int | None = Field(None, ge=0, le=2**63 - 1)
    highest_priority: Priority = "high"


_NEW_QUOTA = TypeAdapter(NewQuota)


@router.get("/quotas", responses=refusals(RecordsUnavailable))
def list_quotas(service: ServiceDep, principal: PrincipalDep) -> Listing[QuotaView]:
    """The quotas that were set for you and for your projects, an admin's call all, and what is used of each.

    `gpu_hours` are those of seven days, with what runs now.
    """
    found = [one for one in service.store.quota_uses() if _concerns(one, principal)]
    return Listing[QuotaView](items=[_view(one) for one in found])


def _concerns(found: QuotaUse, principal: Principal) -> bool:
    if found.kind == "user":
        return principal.is_admin or found.name == principal.user
    return principal.sees(found.name)


@router.put(
    "/quotas/{kind}/{name}",
    openapi_extra=body_of(_NEW_QUOTA),
    responses=refusals(
        MalformedBody,
        UnsupportedMediaType,
        Rejected,
        UserNotFound,
        ProjectNotFound,
        AccountsOff,
        RecordsUnavailable,
    ),
)
def set_quota(  # A route's parameters.
    kind: _Kind,
    name: _Name,
    body: JsonBody,
    request: Request,
    service: ServiceDep,
    principal: PrincipalDep,
) -> QuotaView:
    """Set the whole quota of a user or a project, in place of the one before.

    It acts on what is submitted and started from now on: nothing that runs or waits is ended.
    """
    wanted = parse(body, _NEW_QUOTA)
    _check_exists(kind, name, service)
    service.store.set_quota(kind, name, Quota(**wanted.model_dump()), actor_of(principal, request))
    return next(_view(one) for one in service.store.quota_uses() if (one.kind, one.name) == (kind, name))


@router.delete(
    "/quotas/{kind}/{name}", status_code=204, responses=refusals(Rejected, QuotaNotFound, RecordsUnavailable)
)
def remove_quota(
    kind: _Kind, name: _Name, request: Request, service: ServiceDep, principal: PrincipalDep
) -> None:
    """Let a user or a project have as much as they like, with a weight of 1."""
    if re.fullmatch(NAME, name) is None:
        raise QuotaNotFound(kind, name[:64])
    service.store.remove_quota(kind, name, actor_of(principal, request))


def _check_exists(kind: QuotaKind, name: str, service: Service) -> None:
    """Raises UserNotFound, ProjectNotFound, AccountsOff."""
    if kind == "user":
        if service.authenticator is None:
            raise AccountsOff(
                "This service has no accounts, and so no users; a quota of the project `default` is for all."
            )
        if re.fullmatch(NAME, name) is None:
            raise UserNotFound(name[:64])
        service.store.get_user(name)
    elif name not in {project.name for project in service.store.projects()}:
        raise ProjectNotFound(name[:64])


def _view(found: QuotaUse) -> QuotaView:
    quota, use = found.quota, found.use
    return QuotaView(
        kind=found.kind,
        name=found.name,
        weight=quota.weight,
        running=quota.running,
        queued=quota.queued,
        gpu_hours=quota.gpu_hours,
        bytes=quota.bytes,
        highest_priority=quota.highest_priority,
        used=QuotaUseView(
            running=use.running,
            queued=use.queued,
            gpu_hours=round(sum(use.gpu_hours.values()), 4),
            bytes=use.bytes,
        ),
    )
