"""Signing in on the page: a token is typed once, and a cookie stands for it from then on."""

from fastapi import APIRouter, Request, Response
from pydantic import Field, TypeAdapter

from api import sessions
from api.access import actor_of
from api.authentication import TooManyRequests, Unauthenticated
from api.dependencies import Service, ServiceDep
from api.problems import CrossSiteRequest, EdgeError, MalformedBody, UnsupportedMediaType, refusals
from api.routes.accounts import ACCOUNTS_ON, AccountsOff, body_of, who
from api.submissions import JsonBody, parse
from core.accounts.principal import ANYONE, Principal
from core.accounts.store import PageSession
from core.accounts.tokens import SESSION, new_secret
from core.accounts.tokens import parse as parse_token
from core.documents import Strict
from core.errors import Problem, RecordsUnavailable, Rejected
from gaitway.schema import SessionView

router = APIRouter(tags=["accounts"])


class SignIn(Strict):
    """A token that begins a session of the page."""

    token: str = Field(max_length=200, examples=["gaitway_5be0c1d2e3f4_…"])


_SIGN_IN = TypeAdapter(SignIn)


@router.get("/session", responses=refusals(RecordsUnavailable))
async def read_session(request: Request, response: Response, service: ServiceDep) -> SessionView:
    """Who is signed in, if anybody is; for the page, which asks this before all else."""
    response.headers["Cache-Control"] = "no-store"
    if service.authenticator is None:
        return SessionView(accounts=False, who=who(service, ANYONE))
    try:
        principal = await service.authenticator.of_request(request)
    except EdgeError:
        return SessionView(accounts=True)
    return SessionView(accounts=True, who=who(service, principal))


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
    address = "" if request.client is None else request.client.host
    service.sign_ins.count(address)
    principal = _holder(parse(body, _SIGN_IN).token, service)
    service.sign_ins.give_back(address)
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
    """Store a session of this principal, and give it to the browser. Raises RecordsUnavailable."""
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
    if secret is None or service.authenticator is None:
        return
    sessions.check_sender(request)
    sessions.forget(response)
    try:
        principal = service.authenticator.of_session(secret)
    except Unauthenticated:
        return
    service.store.end_session(secret.id, actor_of(principal, request))
    service.authenticator.forget(secret)
