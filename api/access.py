"""The access that each route needs, in one place; the API does not start with a route that is not listed.

A route with an id in its path also checks whose that is: what lies in other people's projects is not found,
and only its owner or an admin changes it.
"""

from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import structlog
from anyio import to_thread
from fastapi import APIRouter, Depends, Request
from fastapi.routing import APIRoute

from api.dependencies import Service, ServiceDep
from api.problems import EdgeError
from core.accounts.principal import ANYONE, SCOPE_FOR, Ownership, Principal, Role, TokenScope, project_for
from core.accounts.store import Actor
from core.errors import (
    DeliveryNotFound,
    JobNotFound,
    NotFound,
    ProjectNotFound,
    SweepNotFound,
    Unavailable,
    WebhookNotFound,
)
from core.jobs.store import Whose
from core.news.webhook import delivery_number
from core.uploads.record import UploadStore


@dataclass(frozen=True)
class Access:
    """The access that a route needs. role: at least this; None: no token at all.

    user: the role that the user needs, where the token may have a lesser scope. worker: a token of that
    scope, and no other. owns: the thing in its path has to be the user's own, or the user an admin. action:
    its name in the audit log, which begins with the kind of thing; None: it changes nothing, or its own
    transaction writes the entry.
    """

    role: Role | None = Role.VIEWER
    user: Role | None = None
    worker: bool = False
    owns: bool = False
    action: str | None = None


_OPEN = Access(None)
_READ = Access()
_ADMIN = Access(Role.ADMIN)


def _submits(action: str) -> Access:
    return Access(Role.SUBMITTER, action=action)


def _changes(action: str) -> Access:
    return Access(Role.SUBMITTER, owns=True, action=action)


ROUTES: Mapping[str, Access] = {
    # The page's files and the documentation tell nothing about the service's content.
    "GET /": _OPEN,
    "GET /docs": _OPEN,
    "GET /openapi.json": _OPEN,
    "GET /pages/{version}/{path:path}": _OPEN,
    "GET /problems/{code}": _OPEN,
    "GET /healthz": _OPEN,
    "GET /readyz": _OPEN,
    # They are for those who are not signed in yet; they look at the session themselves.
    "GET /session": _OPEN,
    "POST /session": _OPEN,
    "DELETE /session": _OPEN,
    "POST /session/oidc": _OPEN,
    "GET /session/oidc": _OPEN,
    "GET /whoami": _READ,
    "GET /environments": _READ,
    "GET /environments/{environment_id}": _READ,
    "GET /environments/{environment_id:path}/preview": _READ,
    "GET /environments/{package}/{name}": _READ,
    "GET /algorithms": _READ,
    "GET /workers": _READ,
    # It has the passwords of the stores, so that the audit log says who has asked.
    "GET /workers/settings": Access(worker=True, action="worker.joined"),
    "GET /slots": _READ,
    "GET /usage": _READ,
    # It tells of all projects; Prometheus has no need of a token that may change anything.
    "GET /metrics": Access(user=Role.ADMIN),
    "POST /jobs": _submits("job.submitted"),
    "POST /jobs/check": Access(Role.SUBMITTER),
    "POST /jobs/import": _submits("job.imported"),
    "GET /jobs": _READ,
    "GET /jobs/{job_id}": _READ,
    "PATCH /jobs/{job_id}": _changes("job.changed"),
    # They check the owner of each job, and enter it in the audit log.
    "POST /jobs/cancel": Access(Role.SUBMITTER),
    "POST /jobs/delete": Access(Role.SUBMITTER),
    "POST /jobs/{job_id}/cancel": _changes("job.cancelled"),
    "DELETE /jobs/{job_id}": _changes("job.deleted"),
    "GET /jobs/{job_id}/artifacts": _READ,
    "GET /jobs/{job_id}/artifacts/{name}": _READ,
    "GET /jobs/{job_id}/checkpoints": _READ,
    "GET /jobs/{job_id}/checkpoints/{step}": _READ,
    "GET /jobs/{job_id}/events": _READ,
    "GET /jobs/{job_id}/export": _READ,
    "GET /jobs/{job_id}/logs": _READ,
    "GET /jobs/{job_id}/metrics": _READ,
    "GET /jobs/{job_id}/policy": _READ,
    "GET /jobs/{job_id}/poster": _READ,
    "GET /jobs/{job_id}/replay": _READ,
    "GET /jobs/{job_id}/replay/scene": _READ,
    "GET /jobs/{job_id}/report.html": _READ,
    "GET /jobs/{job_id}/simulation": _READ,
    "GET /jobs/{job_id}/specification": _READ,
    "GET /jobs/{job_id}/video": _READ,
    "POST /sweeps": _submits("sweep.submitted"),
    "GET /sweeps": _READ,
    "GET /sweeps/{sweep_id}": _READ,
    "PATCH /sweeps/{sweep_id}": _changes("sweep.changed"),
    "POST /sweeps/{sweep_id}/cancel": _changes("sweep.cancelled"),
    "POST /sweeps/{sweep_id}/resume": _changes("sweep.resumed"),
    "DELETE /sweeps/{sweep_id}": _changes("sweep.deleted"),
    "POST /models": _submits("model.sent"),
    "GET /models": _READ,
    "GET /models/{model_id}": _READ,
    "DELETE /models/{model_id}": _changes("model.deleted"),
    "POST /clips": _submits("clips.sent"),
    "GET /clips": _READ,
    "GET /clips/{clips_id}": _READ,
    "GET /clips/{clips_id}/file": _READ,
    "GET /clips/{clips_id}/replay": _READ,
    "GET /clips/{clips_id}/replay/scene": _READ,
    "PATCH /clips/{clips_id}": _changes("clips.changed"),
    "DELETE /clips/{clips_id}": _changes("clips.deleted"),
    # A viewer has tokens, too; none that may do more.
    "GET /tokens": _READ,
    "POST /tokens": _READ,
    "DELETE /tokens/{token_id}": _READ,
    "GET /projects": _READ,
    "POST /projects": _ADMIN,
    "PATCH /projects/{name}": _ADMIN,
    "GET /projects/{project}/retention": _READ,
    "PUT /projects/{project}/retention": _ADMIN,
    "DELETE /projects/{project}/retention": _ADMIN,
    # It changes nothing.
    "POST /projects/{project}/retention/preview": _READ,
    "GET /projects/{project}/webhooks": _READ,
    "POST /projects/{project}/webhooks": Access(Role.SUBMITTER),
    "GET /projects/{project}/webhooks/{webhook}": _READ,
    "PATCH /projects/{project}/webhooks/{webhook}": Access(Role.SUBMITTER, owns=True),
    "DELETE /projects/{project}/webhooks/{webhook}": Access(Role.SUBMITTER, owns=True),
    "POST /projects/{project}/webhooks/{webhook}/rotate": Access(Role.SUBMITTER, owns=True),
    "POST /projects/{project}/webhooks/{webhook}/test": Access(Role.SUBMITTER, owns=True),
    "GET /projects/{project}/webhooks/{webhook}/deliveries": _READ,
    "GET /jobs/{job_id}/deliveries": _READ,
    "POST /deliveries/{delivery_id}/resend": Access(Role.SUBMITTER, owns=True),
    "GET /quotas": _READ,
    "PUT /quotas/{kind}/{name}": _ADMIN,
    "DELETE /quotas/{kind}/{name}": _ADMIN,
    "GET /users": _ADMIN,
    "POST /users": _ADMIN,
    "PATCH /users/{name}": _ADMIN,
    "GET /audit": _ADMIN,
}


class Forbidden(EdgeError):
    """The token, its user's role or the owner does not allow this."""

    status = 403
    code = "forbidden"
    title = "Not allowed"


def undeclared(routers: Iterable[APIRouter]) -> list[str]:
    """The routes that `ROUTES` does not list, and those that it lists and nobody serves."""
    served = {name for router in routers for route in router.routes for name in names(route)}
    return sorted(served ^ (ROUTES.keys() - {"GET /openapi.json"}))


def names(route: object) -> list[str]:
    """A route as `ROUTES` names it, once for each method; HEAD needs what GET does."""
    assert isinstance(route, APIRoute)  # noqa: S101
    return [f"{method} {route.path}" for method in route.methods or () if method != "HEAD"]


async def authorize(request: Request, service: ServiceDep) -> Principal:
    """Find out who makes the request, and check that they may; for every route.

    Raises Unauthenticated, TooManyRequests, Forbidden, NotFound, RecordsUnavailable.
    """
    method = "GET" if request.method == "HEAD" else request.method
    access = ROUTES[f"{method} {request.scope['route'].path}"]
    if service.authenticator is None or access.role is None:
        return ANYONE
    principal = await service.authenticator.principal(request)
    check_role(access, principal)
    if not principal.is_admin:
        await _check_owner(access, principal, request, service)
    structlog.contextvars.bind_contextvars(user=principal.user)
    if access.action is not None:
        request.state.audited = (access.action, actor_of(principal, request))
    return principal


async def while_allowed(
    pieces: AsyncIterator[bytes], request: Request, service: Service
) -> AsyncIterator[bytes]:
    """The pieces of a stream, up to the first that the one who asked for it may not have any more."""
    async for piece in pieces:
        if service.authenticator is not None and not await _is_still_allowed(request, service):
            return
        yield piece


async def _is_still_allowed(request: Request, service: Service) -> bool:
    assert service.authenticator is not None  # noqa: S101
    try:
        principal = await service.authenticator.of_request(request)
        check_role(_READ, principal)
        if not principal.is_admin:
            await _check_owner(_READ, principal, request, service)
    except (EdgeError, NotFound):
        return False
    except Unavailable:  # An outage of the record ends no stream.
        return True
    return True


PrincipalDep = Annotated[Principal, Depends(authorize)]


def check_role(access: Access, principal: Principal) -> None:
    """Raises Forbidden, which names the scope or the role that is missing."""
    if access.worker or principal.scope is TokenScope.WORKER:
        if not (access.worker and principal.scope is TokenScope.WORKER):
            needed = TokenScope.WORKER if access.worker else SCOPE_FOR[access.role or Role.VIEWER]
            raise _lacks_scope(needed, principal)
        return
    wanted, reached = access.role or Role.VIEWER, principal.scope.role or Role.VIEWER
    if reached.rank < wanted.rank:
        raise _lacks_scope(SCOPE_FOR[wanted], principal)
    wanted = access.user or wanted
    if principal.role.rank < wanted.rank:
        raise Forbidden(
            f"This needs the role {wanted}; {principal.user} is a {principal.role}. An admin gives roles.",
            needed_role=wanted,
        )


def _lacks_scope(needed: TokenScope, principal: Principal) -> Forbidden:
    detail = f"This needs a token of the scope {needed}; this one has the scope {principal.scope}."
    return Forbidden(detail, needed_scope=needed)


async def _check_upload(
    access: Access, principal: Principal, upload_id: str, store: UploadStore[Any], what: str
) -> None:
    found = await to_thread.run_sync(store.owners_of, [upload_id])
    seen = [one for one in found.get(upload_id, ()) if principal.sees(one.project)]
    own = [one for one in seen if principal.may_change(one.owner)]
    missing = store.kind.missing(upload_id[:80])
    if not seen:
        raise missing
    _check(principal, (own or seen)[0], missing, what, owns=access.owns)


async def _check_owner(access: Access, principal: Principal, request: Request, service: Service) -> None:
    """Raises NotFound for a thing in other projects; Forbidden where another user's may not be changed."""
    path = request.path_params
    if (job_id := path.get("job_id")) is not None:
        owner = service.owners.known(job_id) or await to_thread.run_sync(
            service.owners.of, job_id, service.store.owner_of
        )
        _check(principal, owner, JobNotFound(job_id[:64]), f"Job {job_id}", owns=access.owns)
    elif (sweep_id := path.get("sweep_id")) is not None:
        owner = service.owners.known(sweep_id) or await to_thread.run_sync(
            service.owners.of, sweep_id, service.store.owner_of_sweep
        )
        _check(principal, owner, SweepNotFound(sweep_id[:64]), f"Sweep {sweep_id}", owns=access.owns)
    elif (model_id := path.get("model_id")) is not None:
        await _check_upload(access, principal, model_id, service.store.models, "The model")
    elif (clips_id := path.get("clips_id")) is not None:
        await _check_upload(access, principal, clips_id, service.store.clips, "The file of clips")
    elif (delivery_id := path.get("delivery_id")) is not None:
        number = delivery_number(delivery_id)
        webhook = await to_thread.run_sync(service.store.webhook_of, number)
        owner = Ownership(webhook.owner, webhook.project)
        _check(principal, owner, DeliveryNotFound(number), f"The webhook {webhook.name}", owns=access.owns)
    elif (project := path.get("project")) is not None:
        if not principal.sees(project):
            raise ProjectNotFound(project[:64])
        if access.owns:
            webhook = await to_thread.run_sync(service.store.webhook, project, path["webhook"])
            owner = Ownership(webhook.owner, project)
            missing = WebhookNotFound(project, webhook.name)
            _check(principal, owner, missing, f"The webhook {webhook.name}", owns=True)


def check_job(job_id: str, principal: Principal, service: Service) -> None:
    """For a job that is to be changed, and that the path does not name. Raises JobNotFound, Forbidden."""
    if not principal.is_admin:
        owner = service.owners.of(job_id, service.store.owner_of)
        _check(principal, owner, JobNotFound(job_id[:64]), f"Job {job_id}", owns=True)


def _check(principal: Principal, owner: Ownership, missing: NotFound, what: str, *, owns: bool) -> None:
    if not principal.sees(owner.project):
        raise missing
    if owns and not principal.may_change(owner.owner):
        whose = "was made without accounts" if owner.owner is None else f"belongs to {owner.owner}"
        raise Forbidden(f"{what} {whose}: only its owner or an admin may do this.", owner=owner.owner)


def actor_of(principal: Principal, request: Request) -> Actor:
    """The principal as the audit log names it."""
    address = None if request.client is None else request.client.host
    return Actor(principal.user, principal.token, address, request.state.correlation_id)


def ownership_of_new(principal: Principal, project: str | None, service: Service) -> Ownership:
    """Whose the thing becomes that the principal submits. Raises Rejected with the pointer `/project`."""
    existing = [one.name for one in service.store.projects()] if principal.is_admin and project else ()
    return Ownership(principal.user, project_for(principal, project, existing))


def whose(principal: Principal, owner: str | None, project: str | None) -> Whose:
    """The filter of a listing: one's own first, then what others have in one's projects.

    Raises Rejected for a project that the principal does not see.
    """
    readable = principal.readable
    if project is not None and readable is not None:
        project_for(principal, project)
    projects = (project,) if project is not None else None if readable is None else tuple(sorted(readable))
    return Whose(owner=owner, projects=projects, first=principal.user)
