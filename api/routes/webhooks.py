"""Webhooks of a project, and what was sent to them."""

from contextlib import suppress
from functools import partial
from typing import Annotated
from urllib.parse import urlsplit

from anyio import from_thread
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import AfterValidator, Field, SecretStr, TypeAdapter

from api.access import PrincipalDep, actor_of
from api.dependencies import JobId, QueryParameters, ServiceDep
from api.problems import MalformedBody, UnsupportedMediaType, refusals
from api.routes.accounts import ProjectName
from api.submissions import JsonBody, body_of, parse
from api.views import Listing, answer
from core.accounts.principal import NAME
from core.documents import Strict
from core.errors import (
    AddressesWait,
    DeliveryNotFound,
    JobNotFound,
    Problem,
    ProjectNotFound,
    RecordsUnavailable,
    Rejected,
    TooManyWebhooks,
    WebhookExists,
    WebhookNotFound,
    WebhookUnsigned,
)
from core.news.addresses import AddressRefused, NameUnknown, checked_address
from core.news.channels import LONGEST_URL, BadAddress, check_url
from core.news.store import DeliveryPage
from core.news.webhook import (
    DELIVERY_ID,
    ENDS,
    EVENTS,
    MAX_WEBHOOKS,
    TEST,
    Change,
    JobEvent,
    SweepEvent,
    Webhook,
    WebhookName,
    WhichJobs,
    check_signing_secret,
    delivery_number,
    is_http,
    new_message,
    new_signing_secret,
    shown_url,
)
from core.settings import Networks
from gaitway.schema import DeliveryView, NewWebhookView, WebhookView

router = APIRouter(tags=["webhooks"])

_Webhook = Annotated[
    str,
    Path(description="A webhook's name.", examples=["lab-chat"], json_schema_extra={"pattern": f"^{NAME}$"}),
]
_Delivery = Annotated[
    str,
    Path(description="Its id.", examples=["17"], json_schema_extra={"pattern": f"^{DELIVERY_ID}$"}),
]
_Url = Annotated[str, Field(min_length=1, max_length=LONGEST_URL, examples=["https://hooks.lab.edu/gaitway"])]
_Events = Annotated[
    list[JobEvent | SweepEvent],
    Field(min_length=1, max_length=len(EVENTS)),
    AfterValidator(lambda said: list(dict.fromkeys(said))),
]
_LOOK_UP_S = 2.0


class NewWebhook(Strict):
    """A webhook to add. url: of an HTTP receiver, or an Apprise address such as slack://…; see docs/teams.md.

    jobs: `all` of the project, your `own`, or those that name it in `notify`. secret: by default a fresh one.
    """

    name: WebhookName
    url: _Url
    events: _Events = list(ENDS)
    jobs: WhichJobs = "all"
    secret: Annotated[str, Field(max_length=100), AfterValidator(check_signing_secret)] | None = Field(
        default=None, description="`whsec_` and 24 to 64 bytes in base64.", examples=[None]
    )


class WebhookChange(Strict):
    """What changes; the rest stays. url: of the same kind, HTTP or Apprise; what waits goes there, too.

    active: false stops it, and ends what waits; true starts it again, also after an answer 410.
    """

    url: _Url | None = None
    events: _Events | None = None
    jobs: WhichJobs | None = None
    active: bool | None = None


class DeliveryFilters(QueryParameters):
    """A page of deliveries."""

    cursor: str | None = Field(
        None,
        max_length=100,
        description="The `next` of an earlier page.",
        json_schema_extra={"pattern": "^[0-9]{1,18}$"},
    )
    limit: int = Field(50, ge=1, le=200)


_Listed = Annotated[DeliveryFilters, Query()]
_NEW_WEBHOOK, _WEBHOOK_CHANGE = TypeAdapter(NewWebhook), TypeAdapter(WebhookChange)


@router.get("/projects/{project}/webhooks", responses=refusals(ProjectNotFound, RecordsUnavailable))
def list_webhooks(project: ProjectName, service: ServiceDep) -> Listing[WebhookView]:
    """The webhooks of a project, by name, without their secrets."""
    return Listing[WebhookView](items=[_view(one) for one in service.store.webhooks(project)])


@router.post(
    "/projects/{project}/webhooks",
    status_code=201,
    response_model=NewWebhookView,
    openapi_extra=body_of(_NEW_WEBHOOK),
    responses=refusals(
        MalformedBody,
        UnsupportedMediaType,
        Rejected,
        ProjectNotFound,
        WebhookExists,
        TooManyWebhooks,
        AddressesWait,
        RecordsUnavailable,
    ),
)
def add_webhook(
    project: ProjectName, body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep
) -> Response:
    """Tell somebody of the project's jobs, by messages after Standard Webhooks or by Apprise.

    The answer has the secret that signs the messages, which nobody can ask for again.
    """
    wanted = parse(body, _NEW_WEBHOOK)
    # Before what takes long: there may be no such project, or no room in it.
    if len(service.store.webhooks(project)) >= MAX_WEBHOOKS:
        raise TooManyWebhooks(project, MAX_WEBHOOKS)
    _check_address(wanted.url, service.settings.news_networks)
    webhook = Webhook(
        project=project,
        name=wanted.name,
        owner=principal.user,
        url=SecretStr(wanted.url),
        events=tuple(wanted.events),
        jobs=wanted.jobs,
        secret=_secret(wanted),
        created_at=service.store.now(),
    )
    service.store.add_webhook(webhook, actor_of(principal, request))
    place = f"/projects/{project}/webhooks/{webhook.name}"
    return answer(_with_secret(webhook), 201, {"Location": place})


def _check_address(url: str, allowed: Networks) -> None:
    """Raises Rejected, AddressesWait. A name that cannot be looked up now may be one later."""
    try:
        check_url(url)
        parts = urlsplit(url)
        if parts.scheme in ("http", "https"):
            port = parts.port or (443 if parts.scheme == "https" else 80)
            look_up = partial(checked_address, str(parts.hostname), port, allowed, timeout_s=_LOOK_UP_S)
            with suppress(NameUnknown):
                from_thread.run(look_up)
    except BadAddress as error:
        raise _wrong("url", f"`url` {error}.") from None
    except AddressRefused as error:
        raise _wrong("url", str(error)) from None


def _secret(wanted: NewWebhook) -> SecretStr | None:
    if is_http(wanted.url):
        return new_signing_secret() if wanted.secret is None else SecretStr(wanted.secret)
    if wanted.secret is not None:
        raise _wrong("secret", "`secret` is for HTTP receivers alone: messages by Apprise are not signed.")
    return None


def _wrong(field: str, detail: str) -> Rejected:
    return Rejected(detail, [Problem(f"/{field}", detail)])


@router.get("/projects/{project}/webhooks/{webhook}", responses=refusals(WebhookNotFound, RecordsUnavailable))
def read_webhook(project: ProjectName, webhook: _Webhook, service: ServiceDep) -> WebhookView:
    """A webhook, without its secret."""
    return _view(service.store.webhook(project, webhook))


@router.patch(
    "/projects/{project}/webhooks/{webhook}",
    openapi_extra=body_of(_WEBHOOK_CHANGE),
    responses=refusals(
        MalformedBody, UnsupportedMediaType, Rejected, WebhookNotFound, AddressesWait, RecordsUnavailable
    ),
)
def change_webhook(
    project: ProjectName,
    webhook: _Webhook,
    body: JsonBody,
    request: Request,
    service: ServiceDep,
    principal: PrincipalDep,
) -> WebhookView:
    """Send to another address, tell of other events or jobs, stop, or start again."""
    change = parse(body, _WEBHOOK_CHANGE)
    if change.url is not None:
        if is_http(change.url) != service.store.webhook(project, webhook).is_http:
            raise _wrong(
                "url", "`url` has to be of the same kind, since only HTTP has a secret: add another webhook."
            )
        _check_address(change.url, service.settings.news_networks)
    wanted = Change.model_validate(change.model_dump())
    return _view(service.store.change_webhook(project, webhook, wanted, actor_of(principal, request)))


@router.post(
    "/projects/{project}/webhooks/{webhook}/rotate",
    responses=refusals(WebhookNotFound, WebhookUnsigned, RecordsUnavailable),
)
def rotate_secret(
    project: ProjectName, webhook: _Webhook, request: Request, service: ServiceDep, principal: PrincipalDep
) -> NewWebhookView:
    """Sign by a new secret, which the answer has this once. The old one signs beside it for a day.

    The one before the old one is forgotten: after a leak, ask twice.
    """
    actor = actor_of(principal, request)
    return _with_secret(service.store.rotate_secret(project, webhook, new_signing_secret(), actor))


@router.delete(
    "/projects/{project}/webhooks/{webhook}",
    status_code=204,
    responses=refusals(WebhookNotFound, RecordsUnavailable),
)
def delete_webhook(
    project: ProjectName, webhook: _Webhook, request: Request, service: ServiceDep, principal: PrincipalDep
) -> None:
    """Send nothing more to it, and forget what was sent."""
    service.store.remove_webhook(project, webhook, actor_of(principal, request))


@router.post(
    "/projects/{project}/webhooks/{webhook}/test",
    status_code=202,
    response_description="It is sent within a second; the deliveries show how that went",
    responses=refusals(WebhookNotFound, RecordsUnavailable),
)
def test_webhook(project: ProjectName, webhook: _Webhook, service: ServiceDep) -> DeliveryView:
    """Send a message of the type `webhook.test`, as the news of jobs are sent."""
    about = {"webhook": webhook, "project": project}
    message = new_message(TEST, service.store.now(), about, project=project)
    return DeliveryView.model_validate(service.store.add_test(project, webhook, message))


@router.get(
    "/projects/{project}/webhooks/{webhook}/deliveries",
    responses=refusals(WebhookNotFound, Rejected, RecordsUnavailable),
)
def list_deliveries(
    project: ProjectName, webhook: _Webhook, listed: _Listed, service: ServiceDep
) -> Listing[DeliveryView]:
    """What was sent to a webhook in the last week and what came of it, the newest first."""
    service.store.webhook(project, webhook)
    return _page(service.store.deliveries(project=project, webhook=webhook, **listed.model_dump()))


@router.get(
    "/jobs/{job_id}/deliveries",
    tags=["jobs"],
    responses=refusals(JobNotFound, Rejected, RecordsUnavailable),
)
def list_deliveries_of_job(job_id: JobId, listed: _Listed, service: ServiceDep) -> Listing[DeliveryView]:
    """What was sent about a job in the last week and what came of it, the newest first."""
    service.store.owner_of(job_id)
    return _page(service.store.deliveries(job=job_id, **listed.model_dump()))


@router.post(
    "/deliveries/{delivery_id}/resend",
    status_code=202,
    response_description="It is sent within a second",
    responses=refusals(DeliveryNotFound, RecordsUnavailable),
)
def resend(delivery_id: _Delivery, service: ServiceDep) -> DeliveryView:
    """Send the message again, with the same `webhook-id`, as a delivery that is tried for a day.

    One that still waits ends in its favour.
    """
    return DeliveryView.model_validate(service.store.resend(delivery_number(delivery_id)))


def _page(page: DeliveryPage) -> Listing[DeliveryView]:
    items = [DeliveryView.model_validate(delivery) for delivery in page.deliveries]
    return Listing[DeliveryView](items=items, next=page.next_cursor)


def _view(webhook: Webhook) -> WebhookView:
    url = shown_url(webhook.url.get_secret_value())
    return WebhookView(**webhook.model_dump(exclude={"url", "secret", "old_secret"}), url=url)


def _with_secret(webhook: Webhook) -> NewWebhookView:
    secret = None if webhook.secret is None else webhook.secret.get_secret_value()
    return NewWebhookView(**_view(webhook).model_dump(), secret=secret)
