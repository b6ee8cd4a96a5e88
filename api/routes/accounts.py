"""Users, projects, tokens and the audit log; and who one is."""

import re
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request
from pydantic import AfterValidator, Field, TypeAdapter

from api.access import Forbidden, PrincipalDep, actor_of
from api.dependencies import QueryParameters, Service, ServiceDep
from api.problems import MalformedBody, UnsupportedMediaType, refusals
from api.submissions import JsonBody, body_of, parse
from api.views import Listing
from core.accounts.principal import (
    DEFAULT_PROJECT,
    NAME,
    SCOPE_FOR,
    AccountName,
    Principal,
    Role,
    TokenScope,
)
from core.accounts.store import Token, User
from core.accounts.tokens import TOKEN_ID, new_secret
from core.documents import Strict
from core.errors import (
    Conflict,
    LastAdmin,
    NotFound,
    Problem,
    ProjectExists,
    ProjectNotFound,
    RecordsUnavailable,
    Rejected,
    SubjectTaken,
    TokenNotFound,
    TooManyTokens,
    UserExists,
    UserNotFound,
)
from core.jobs.spec import Text
from gaitway.schema import AuditView, NewTokenView, ProjectView, TokenView, UserView, WhoView

router = APIRouter(tags=["accounts"])


def _named(pattern: str, missing: Callable[[str], NotFound]) -> Any:
    """A name in a path. The format is only documented: a validator answers a wrong one with 404."""

    def check(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise missing(text[:64])
        return text

    return AfterValidator(check)


UserName = Annotated[
    str, Path(examples=["ann"], json_schema_extra={"pattern": f"^{NAME}$"}), _named(NAME, UserNotFound)
]
ProjectName = Annotated[
    str, Path(examples=["gaits"], json_schema_extra={"pattern": f"^{NAME}$"}), _named(NAME, ProjectNotFound)
]
TokenId = Annotated[
    str,
    Path(examples=["5be0c1d2e3f4"], json_schema_extra={"pattern": f"^{TOKEN_ID}$"}),
    _named(TOKEN_ID, TokenNotFound),
]


class AccountsOff(Conflict):
    """GAITWAY_ACCOUNTS is not set, so nobody has an account here."""

    code = "accounts-off"
    title = "This service has no accounts"


async def _accounts_on(service: ServiceDep) -> None:
    if service.authenticator is None:
        raise AccountsOff("This service has no accounts; docs/teams.md says how to turn them on.")


ACCOUNTS_ON = [Depends(_accounts_on)]
_REFUSED = (AccountsOff, MalformedBody, UnsupportedMediaType, Rejected, RecordsUnavailable)


class NewUser(Strict):
    """A user to add. projects: those that it becomes a member of."""

    name: AccountName
    role: Role = Role.SUBMITTER
    projects: list[AccountName] = Field(default=[DEFAULT_PROJECT], max_length=100)


class UserChange(Strict):
    """What changes; the rest stays. active: false refuses all of the user's tokens.

    subject: the account of the identity provider that signs in as this user, `ISSUER#ID`; a sign-in that is
    refused because the name is taken says it.
    """

    role: Role | None = None
    active: bool | None = None
    subject: Annotated[str, Field(max_length=600, pattern=r"^[!-~]+#[ -~]+$")] | None = Field(
        default=None, examples=["https://id.lab.edu/realms/lab#0b1c…"]
    )


class NewProject(Strict):
    """A project to add."""

    name: AccountName


class MembersChange(Strict):
    """Who enters the project, and who leaves it."""

    add: list[AccountName] = Field(default=[], max_length=1000)
    remove: list[AccountName] = Field(default=[], max_length=1000)


class NewToken(Strict):
    """A token to make. user: by default oneself; an admin makes them for others."""

    name: Annotated[str, Field(max_length=100, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")] = ""
    scope: TokenScope
    user: AccountName | None = None
    expires_in_days: Annotated[int, Field(ge=1, le=3650)] | None = Field(
        default=90, description="null: it does not expire."
    )


_NEW_USER, _USER_CHANGE = TypeAdapter(NewUser), TypeAdapter(UserChange)
_NEW_PROJECT, _MEMBERS = TypeAdapter(NewProject), TypeAdapter(MembersChange)
_NEW_TOKEN = TypeAdapter(NewToken)


@router.get("/whoami", responses=refusals(RecordsUnavailable))
def who_am_i(service: ServiceDep, principal: PrincipalDep) -> WhoView:
    """Whose token the request has, and what it may do."""
    return who(service, principal)


def who(service: Service, principal: Principal) -> WhoView:
    """The principal as the service shows it."""
    return WhoView(
        accounts=service.authenticator is not None,
        user=principal.user,
        role=principal.role,
        scope=principal.scope,
        projects=tuple(sorted(principal.projects)),
        token=principal.token,
        expires_at=principal.expires_at,
    )


class TokenFilters(QueryParameters):
    """user: whose; an admin sees those of all by default, others only their own."""

    user: AccountName | None = None


@router.get(
    "/tokens", dependencies=ACCOUNTS_ON, responses=refusals(AccountsOff, Rejected, RecordsUnavailable)
)
def list_tokens(
    listed: Annotated[TokenFilters, Query()], service: ServiceDep, principal: PrincipalDep
) -> Listing[TokenView]:
    """Tokens, the newest first, without their secrets."""
    user = listed.user if principal.is_admin else principal.user
    found = service.store.tokens(user)
    return Listing[TokenView](items=[TokenView.model_validate(token) for token in found])


@router.post(
    "/tokens",
    status_code=201,
    dependencies=ACCOUNTS_ON,
    openapi_extra=body_of(_NEW_TOKEN),
    responses=refusals(*_REFUSED, UserNotFound, TooManyTokens, Forbidden),
)
def create_token(
    body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep
) -> NewTokenView:
    """Make a token, which may not do more than the one that makes it, nor live longer; an admin's makes any.

    The answer has the secret, which nobody can ask for again.
    """
    wanted = parse(body, _NEW_TOKEN)
    user = wanted.user or str(principal.user)
    now, days = service.store.now(), wanted.expires_in_days
    expires_at = None if days is None else now + timedelta(days=days)
    if not principal.is_admin:
        _check_no_more(wanted, principal)
        if principal.expires_at is not None:
            expires_at = min(expires_at or principal.expires_at, principal.expires_at)
    secret = new_secret()
    token = Token(
        id=secret.id,
        user=user,
        name=wanted.name,
        scope=wanted.scope,
        created_at=now,
        expires_at=expires_at,
    )
    added = service.store.add_token(token, secret, actor_of(principal, request))
    return NewTokenView(**added.model_dump(), secret=secret.text)


def _check_no_more(wanted: NewToken, principal: Principal) -> None:
    """Raises Forbidden."""
    if wanted.user not in (None, principal.user):
        raise Forbidden("Only an admin makes tokens for others.", needed_role=Role.ADMIN)
    reached, own = wanted.scope.role, principal.acts_as
    if reached is None or own is None or reached.rank > own.rank:
        raise Forbidden(
            f"A token of the scope {principal.scope}, of a {principal.role}, makes none of the scope "
            f"{wanted.scope}.",
            needed_role=reached or Role.ADMIN,
        )


@router.delete(
    "/tokens/{token_id}",
    status_code=204,
    dependencies=ACCOUNTS_ON,
    responses=refusals(AccountsOff, TokenNotFound, Forbidden, RecordsUnavailable),
)
def revoke_token(
    token_id: TokenId,
    request: Request,
    service: ServiceDep,
    principal: PrincipalDep,
) -> None:
    """Revoke one of your tokens that may do no more than the one with which you ask; an admin revokes any.

    Nothing accepts it after two seconds.
    """
    user = None if principal.is_admin else principal.user
    if user is not None:
        _check_reaches(token_id, service.store.tokens(user), principal)
    service.store.revoke_token(token_id, actor_of(principal, request), user=user)


def _check_reaches(token_id: str, own: Sequence[Token], principal: Principal) -> None:
    """Raises Forbidden where the token is one of these and may do more: who has found a token that reads
    cannot shut its user out."""
    scope = next((token.scope for token in own if token.id == token_id), principal.scope)
    needed, reached = scope.role or Role.ADMIN, principal.scope.role or Role.VIEWER
    if reached.rank < needed.rank:
        raise Forbidden(
            f"A token of the scope {principal.scope} revokes none of the scope {scope}.",
            needed_scope=SCOPE_FOR[needed],
        )


@router.get("/users", dependencies=ACCOUNTS_ON, responses=refusals(AccountsOff, RecordsUnavailable))
def list_users(service: ServiceDep) -> Listing[UserView]:
    """All users, by name."""
    return Listing[UserView](items=[UserView.model_validate(user) for user in service.store.users()])


@router.post(
    "/users",
    status_code=201,
    dependencies=ACCOUNTS_ON,
    openapi_extra=body_of(_NEW_USER),
    responses=refusals(*_REFUSED, UserExists, ProjectNotFound),
)
def add_user(body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep) -> UserView:
    """Add a user, who gets in by a token that an admin makes, or by the identity provider once linked."""
    wanted = parse(body, _NEW_USER)
    user = User(
        name=wanted.name,
        role=wanted.role,
        projects=tuple(dict.fromkeys(wanted.projects)),
        created_at=service.store.now(),
    )
    try:
        return UserView.model_validate(service.store.add_user(user, actor_of(principal, request)))
    except ProjectNotFound as error:
        raise Rejected(error.detail, [Problem("/projects", error.detail)]) from None


@router.patch(
    "/users/{name}",
    dependencies=ACCOUNTS_ON,
    openapi_extra=body_of(_USER_CHANGE),
    responses=refusals(*_REFUSED, UserNotFound, LastAdmin, SubjectTaken),
)
def change_user(
    name: UserName,
    body: JsonBody,
    request: Request,
    service: ServiceDep,
    principal: PrincipalDep,
) -> UserView:
    """Give a user another role, disable or enable them, or link an account of the identity provider.

    Their jobs stay.
    """
    change = parse(body, _USER_CHANGE)
    issuer = service.settings.oidc_issuer
    if change.subject is not None and issuer is not None and not change.subject.startswith(f"{issuer}#"):
        sentence = f"Accounts of this service's identity provider are {issuer}#ID."
        raise Rejected(sentence, [Problem("/subject", sentence)])
    user = service.store.change_user(name, actor_of(principal, request), **change.model_dump())
    return UserView.model_validate(user)


@router.get("/projects", responses=refusals(RecordsUnavailable))
def list_projects(service: ServiceDep, principal: PrincipalDep) -> Listing[ProjectView]:
    """The projects that you see, with their members."""
    found = [project for project in service.store.projects() if principal.sees(project.name)]
    return Listing[ProjectView](items=[ProjectView.model_validate(project) for project in found])


@router.post(
    "/projects",
    status_code=201,
    dependencies=ACCOUNTS_ON,
    openapi_extra=body_of(_NEW_PROJECT),
    responses=refusals(*_REFUSED, ProjectExists),
)
def add_project(
    body: JsonBody, request: Request, service: ServiceDep, principal: PrincipalDep
) -> ProjectView:
    """Add a project, which has no members yet."""
    wanted = parse(body, _NEW_PROJECT)
    project = service.store.add_project(wanted.name, actor_of(principal, request))
    return ProjectView.model_validate(project)


@router.patch(
    "/projects/{name}",
    dependencies=ACCOUNTS_ON,
    openapi_extra=body_of(_MEMBERS),
    responses=refusals(*_REFUSED, ProjectNotFound),
)
def change_members(
    name: ProjectName,
    body: JsonBody,
    request: Request,
    service: ServiceDep,
    principal: PrincipalDep,
) -> ProjectView:
    """Let users enter a project or leave it. What they submitted there stays there."""
    change, actor = parse(body, _MEMBERS), actor_of(principal, request)
    try:
        project = service.store.change_members(name, actor, add=change.add, remove=change.remove)
    except UserNotFound as error:
        place = "/add" if error.facts["user"] in change.add else "/remove"
        raise Rejected(error.detail, [Problem(place, error.detail)]) from None
    return ProjectView.model_validate(project)


class AuditFilters(QueryParameters):
    """Filters of the audit log; each one given must match."""

    user: AccountName | None = None
    action: Text | None = Field(None, description="Its beginning, such as `job.` or `token.revoked`.")
    object: Text | None = Field(None, description="Such as `job 019aa3c2f0b1-5be0c1d2e3`.")
    cursor: str | None = Field(
        None,
        max_length=100,
        description="The `next` of an earlier page.",
        json_schema_extra={"pattern": "^[0-9]{1,18}$"},
    )
    limit: int = Field(50, ge=1, le=200)


@router.get("/audit", dependencies=ACCOUNTS_ON, responses=refusals(AccountsOff, Rejected, RecordsUnavailable))
def read_audit(listed: Annotated[AuditFilters, Query()], service: ServiceDep) -> Listing[AuditView]:
    """What was done, by whom and from where, the newest first. Nobody can change or remove an entry."""
    page = service.store.audit(**listed.model_dump())
    items = [AuditView.model_validate(entry) for entry in page.entries]
    return Listing[AuditView](items=items, next=page.next_cursor)
