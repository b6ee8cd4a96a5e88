"""The records of users, projects, tokens and the audit log, and the interface of their store."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Protocol

from pydantic import Field

from core.accounts.principal import Principal, Role, TokenScope
from core.accounts.provider import Grant
from core.accounts.tokens import Secret
from core.documents import Stored


class User(Stored):
    """subject: of the identity provider, for one who came from there or whom an admin linked."""

    name: str
    role: Role
    active: bool = True
    subject: str | None = None
    projects: tuple[str, ...] = ()
    created_at: datetime


class Project(Stored):
    name: str
    members: tuple[str, ...] = ()
    created_at: datetime


class Token(Stored):
    """last_used_at: to the minute."""

    id: str
    user: str
    name: str
    scope: TokenScope
    created_at: datetime
    expires_at: datetime | None = None
    last_used_at: datetime | None = None
    revoked_at: datetime | None = None


class PageSession(Stored):
    """Somebody is signed in on the page.

    token: the id of the token that did it; None: the identity provider said who it is.
    """

    id: str
    user: str
    scope: TokenScope
    token: str | None = None
    created_at: datetime
    expires_at: datetime


class AuditEntry(Stored):
    """Something that was done. object: its kind and id, such as `job 019aa3c2f0b1-5be0c1d2e3`.

    user, token: None without accounts, and before anybody was known. address: of the client.
    """

    id: int = 0
    at: datetime | None = None
    user: str | None = None
    token: str | None = None
    action: str
    object: str | None = None
    details: dict[str, Any] = Field(default_factory=dict)
    address: str | None = None
    correlation_id: str | None = None


@dataclass(frozen=True)
class Actor:
    """Who changes an account, as the audit log names it."""

    user: str | None = None
    token: str | None = None
    address: str | None = None
    correlation_id: str | None = None


@dataclass(frozen=True)
class KnownToken:
    """A token that was found by its id, with what its check needs. `principal` has no say before that."""

    token: Token
    sha256: str
    is_active: bool
    principal: Principal


@dataclass(frozen=True)
class KnownSession:
    """A session that was found by its id and has not ended, with what its check needs."""

    sha256: str
    is_active: bool
    principal: Principal


@dataclass(frozen=True)
class AuditPage:
    """Some entries, newest first, and the cursor of the next page; None at the end."""

    entries: Sequence[AuditEntry]
    next_cursor: str | None


class AccountStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached.

    A method with an `actor` writes its entry of the audit log in the transaction that makes the change.
    """

    def find_token(self, token_id: str) -> KnownToken | None:
        """The token and its user; notes its use, at most once a minute."""
        ...

    def add_session(self, session: PageSession, secret: Secret, actor: Actor) -> None:
        """Store it, and forget those that have expired. Raises UserNotFound."""
        ...

    def find_session(self, session_id: str, idle: timedelta) -> KnownSession | None:
        """The session, unless it has expired or was not used for that long; notes its use, as for a token."""
        ...

    def end_session(self, session_id: str, actor: Actor) -> None:
        """Forget it; one that has ended before is no error."""
        ...

    def now(self) -> datetime:
        """The store's clock in UTC."""
        ...

    def add_user(self, user: User, actor: Actor) -> User:
        """Store a new user as a member of its projects. Raises UserExists, ProjectNotFound."""
        ...

    def get_user(self, name: str) -> User:
        """Raises UserNotFound."""
        ...

    def users(self) -> Sequence[User]:
        """All of them, by name."""
        ...

    def change_user(
        self,
        name: str,
        actor: Actor,
        *,
        role: Role | None = None,
        active: bool | None = None,
        subject: str | None = None,
    ) -> User:
        """Disabling a user, or linking another subject, ends their sessions.

        Raises UserNotFound; LastAdmin where no active admin would be left; SubjectTaken.
        """
        ...

    def admit(self, grant: Grant, actor: Actor) -> User:
        """Who signs in at the identity provider: the user with this subject, or a new one.

        Projects that are missing are made. Nothing of a disabled user changes, and the last active admin
        stays one. Raises SubjectDiffers where a user has the name already: the provider's word alone does
        not make somebody that user.
        """
        ...

    def add_project(self, name: str, actor: Actor) -> Project:
        """Raises ProjectExists."""
        ...

    def projects(self) -> Sequence[Project]:
        """All of them, by name."""
        ...

    def change_members(
        self, project: str, actor: Actor, *, add: Sequence[str] = (), remove: Sequence[str] = ()
    ) -> Project:
        """Raises ProjectNotFound, UserNotFound."""
        ...

    def add_token(self, token: Token, secret: Secret, actor: Actor) -> Token:
        """Raises UserNotFound; TooManyTokens where the user has MAX_TOKENS that are valid."""
        ...

    def tokens(self, user: str | None = None) -> Sequence[Token]:
        """All of them or a user's, the newest first."""
        ...

    def revoke_token(self, token_id: str, actor: Actor, *, user: str | None = None) -> Token:
        """Its sessions end, too, and it stays revoked. user: only if it is theirs. Raises TokenNotFound."""
        ...

    def note(self, entries: Sequence[AuditEntry]) -> None:
        """Append to the audit log entries that say `at`."""
        ...

    def audit(
        self,
        *,
        user: str | None = None,
        action: str | None = None,
        object: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> AuditPage:
        """Entries that match, the newest first. action: its beginning. Raises Rejected for a wrong cursor."""
        ...
