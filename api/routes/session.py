"""Signing in on the page, by a token that is typed once or at the identity provider."""

import structlog
from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import Field, TypeAdapter

from api import sessions
from api.access import actor_of
from api.authentication import TooManyRequests, Unauthenticated
from api.dependencies import Service, ServiceDep
from api.oidc import Attempt, IdentityProvider, PagePlace, ProviderAway
from api.problems import CrossSiteRequest, EdgeError, MalformedBody, UnsupportedMediaType, refusals
from api.routes.accounts import ACCOUNTS_ON, AccountsOff, who
from api.routes.page import page_with_refusal
from api.submissions import JsonBody, body_of, parse
from core.accounts.principal import ANYONE, Principal, TokenScope
from core.accounts.provider import ProviderRules, SignInRefused
from core.accounts.store import Actor, PageSession
from core.accounts.tokens import SESSION, Secret, new_secret
from core.accounts.tokens import parse as parse_token
from core.documents import Strict
from core.errors import Conflict, Problem, RecordsUnavailable, Rejected, Unavailable
from gaitway.schema import ProviderView, SessionView

router = APIRouter(tags=["accounts"])
log = structlog.get_logger()
_CALLBACK = "/session/oidc"


class SignIn(Strict):
    """A token that begins a session of the page."""

    token: str = Field(max_length=200, examples=["gaitway_5be0c1d2e3f4_…"])


_SIGN_IN = TypeAdapter(SignIn)


class Begin(Strict):
    """Where the page was, which is shown again after the sign-in."""

    back: PagePlace = ""


_BEGIN = TypeAdapter(Begin)


@router.get("/session", responses=refusals(RecordsUnavailable))
async def read_session(request: Request, response: Response, service: ServiceDep) -> SessionView:
    """Who is signed in, if anybody is; for the page, which asks this before all else."""
    response.headers["Cache-Control"] = "no-store"
    provider = None if service.provider is None else service.provider.name
    if service.authenticator is None:
        return SessionView(accounts=False, who=who(service, ANYONE))
    try:
        principal = await service.authenticator.of_request(request)
    except EdgeError:
        return SessionView(accounts=True, provider=provider)
    return SessionView(accounts=True, provider=provider, who=who(service, principal))


@router.post(
    "/session",
    status_code=201,
    dependencies=ACCOUNTS_ON,
    openapi_extra=body_of(_SIGN_IN),
    responses=refusals(
        AccountsOff,
        CrossSiteRequest,
        MalformedBody,
        UnsupportedMediaType,
        Rejected,
        TooManyRequests,
        RecordsUnavailable,
    ),
)
def sign_in(body: JsonBody, request: Request, response: Response, service: ServiceDep) -> SessionView:
    """Begin a session of the page, which ends with the token, by `DELETE /session`, and when it is not used.

    For the page alone: programs send the token itself.
    """
    sessions.check_sender(request)
    service.sign_ins.count(_address(request))
    principal = _holder(parse(body, _SIGN_IN).token, service)
    service.sign_ins.give_back(_address(request))
    begin(principal, request, response, service, over_tls=sessions.is_over_tls(request))
    return SessionView(accounts=True, who=who(service, principal))


def _holder(text: str, service: Service) -> Principal:
    """Whose token it is. Raises Rejected with the pointer `/token`."""
    assert service.authenticator is not None  # noqa: S101
    secret = parse_token(text.strip())
    sentence = "This is no token: one begins with gaitway_ and is shown once, when it is made."
    if secret is not None:
        try:
            principal = service.authenticator.of_token(secret)
        except Unauthenticated as error:
            sentence = error.detail
            if error.facts["reason"] == "unknown":
                sentence = "This service does not know this token."
        else:
            if principal.acts_as is not None:
                return principal
            sentence = "This token lets a worker join, and nobody sign in."
    raise Rejected(sentence, [Problem("/token", sentence)])


def begin(
    principal: Principal, request: Request, response: Response, service: Service, *, over_tls: bool
) -> None:
    """Store a session of this principal, and give it to the browser, in place of an earlier one.

    Raises RecordsUnavailable.
    """
    secret, now = new_secret(SESSION), service.store.now()
    lifetime = service.settings.session_lifetime
    if principal.expires_at is not None:
        lifetime = min(lifetime, principal.expires_at - now)
    session = PageSession(
        id=secret.id,
        user=str(principal.user),
        scope=principal.scope,
        token=principal.token,
        created_at=now,
        expires_at=now + lifetime,
    )
    service.store.add_session(session, secret, actor_of(principal, request))
    if (earlier := sessions.session_of(request)) is not None:
        _end(earlier, request, service)
    sessions.keep(response, secret, lifetime, over_tls=over_tls)
    response.headers["Cache-Control"] = "no-store"


@router.delete(
    "/session",
    status_code=204,
    dependencies=ACCOUNTS_ON,
    responses=refusals(AccountsOff, CrossSiteRequest, RecordsUnavailable),
)
def sign_out(request: Request, response: Response, service: ServiceDep) -> None:
    """End the session that the request's cookie holds, if there is one."""
    secret = sessions.session_of(request)
    if secret is None:
        return
    sessions.check_sender(request)
    sessions.forget(response)
    _end(secret, request, service)


def _end(secret: Secret, request: Request, service: Service) -> None:
    """End this session, unless it has ended or is none."""
    assert service.authenticator is not None  # noqa: S101
    try:
        principal = service.authenticator.of_session(secret)
    except Unauthenticated:
        return
    service.store.end_session(secret.id, actor_of(principal, request))
    service.authenticator.forget(secret)


class NoProvider(Conflict):
    """GAITWAY_OIDC_ISSUER is not set: users sign in by tokens."""

    code = "no-provider"
    title = "There is no identity provider"


@router.post(
    "/session/oidc",
    openapi_extra=body_of(_BEGIN),
    responses=refusals(
        NoProvider,
        CrossSiteRequest,
        MalformedBody,
        UnsupportedMediaType,
        Rejected,
        TooManyRequests,
        ProviderAway,
    ),
)
def begin_at_provider(
    body: JsonBody, request: Request, response: Response, service: ServiceDep
) -> ProviderView:
    """The address at the identity provider where the page sends the browser, which comes back from there."""
    provider = _provider(service)
    sessions.check_sender(request)
    back = parse(body, _BEGIN).back
    service.sign_ins.count(_address(request))
    # The browser's own idea of where we are: a proxy may ask for us elsewhere.
    origin = request.headers.get("origin") or str(request.base_url).rstrip("/")
    attempt, location = provider.begin(f"{origin}{_CALLBACK}", back)
    sessions.keep_attempt(response, attempt.text, over_tls=_is_over_tls(attempt))
    response.headers["Cache-Control"] = "no-store"
    return ProviderView(location=location)


@router.get(_CALLBACK, include_in_schema=False)
def come_back(request: Request, service: ServiceDep) -> Response:
    """The browser comes back from the identity provider: signed in, or to a page that says why not."""
    provider = _provider(service)
    attempt = Attempt.read(sessions.attempt_of(request))
    answer: Response
    try:
        principal = _admitted(provider, attempt, request, service)
        answer = RedirectResponse(f"/{attempt.back if attempt else ''}", status_code=303)
        over_tls = attempt is not None and _is_over_tls(attempt)
        begin(principal, request, answer, service, over_tls=over_tls)
        service.sign_ins.give_back(_address(request))
    except (Conflict, Unavailable) as error:
        log.warning("sign_in_refused", code=error.code, detail=error.detail)
        status = 503 if isinstance(error, Unavailable) else 403
        answer = page_with_refusal(error.detail, status)
    sessions.forget_attempt(answer)
    return answer


def _admitted(
    provider: IdentityProvider, attempt: Attempt | None, request: Request, service: Service
) -> Principal:
    claims = provider.finish(attempt, request.query_params)
    grant = ProviderRules.of(service.settings).grant(claims)
    address = None if request.client is None else request.client.host
    actor = Actor(grant.name, None, address, request.state.correlation_id)
    user = service.store.admit(grant, actor)
    if not user.active:
        raise SignInRefused(f"The user {user.name} is disabled: ask an admin.")
    return Principal(user.name, user.role, TokenScope.ADMIN, frozenset(user.projects))


def _provider(service: Service) -> IdentityProvider:
    if service.provider is None:
        raise NoProvider("This service has no identity provider; docs/teams.md says how to name one.")
    return service.provider


def _is_over_tls(attempt: Attempt) -> bool:
    return attempt.redirect_uri.startswith("https:")


def _address(request: Request) -> str:
    return "" if request.client is None else request.client.host
