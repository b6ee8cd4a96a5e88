"""Users, projects and tokens; the audit log."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from typing import Any

from pydantic_core import from_json, to_json
from sqlalchemy import Connection, Row, Select, delete, func, or_, select, update
from sqlalchemy.dialects.postgresql import aggregate_order_by, insert

from core.accounts.principal import Principal, Role, TokenScope
from core.accounts.provider import Grant
from core.accounts.store import (
    Actor,
    AuditEntry,
    AuditPage,
    KnownSession,
    KnownToken,
    PageSession,
    Project,
    Token,
    User,
)
from core.accounts.tokens import MAX_TOKENS, Secret
from core.adapters.postgres.engine import Session
from core.adapters.postgres.tables import NOW, audit, members, projects, sessions, tokens, users
from core.errors import (
    LastAdmin,
    Problem,
    ProjectExists,
    ProjectNotFound,
    Rejected,
    SubjectDiffers,
    SubjectTaken,
    TokenNotFound,
    TooManyTokens,
    UserExists,
    UserNotFound,
)

# The last use of a token or a session is written at most this often.
_USE_NOTED_EVERY = timedelta(minutes=1)
_MEMBERSHIPS = (
    select(func.array_agg(aggregate_order_by(members.c.project, members.c.project)))
    .where(members.c.user_name == users.c.name)
    .scalar_subquery()
    .label("projects")
)
_USERS = select(users, _MEMBERSHIPS)
_PROJECTS = select(
    projects,
    select(func.array_agg(aggregate_order_by(members.c.user_name, members.c.user_name)))
    .where(members.c.project == projects.c.name)
    .scalar_subquery()
    .label("members"),
)
_TOKENS = select(*(column for column in tokens.c if column.name not in ("user_name", "sha256"))).add_columns(
    tokens.c.user_name.label("user")
)
_VALID_TOKENS = (
    select(func.count())
    .select_from(tokens)
    .where(tokens.c.revoked_at.is_(None), or_(tokens.c.expires_at.is_(None), tokens.c.expires_at > NOW))
)
_WAS_USED = or_(tokens.c.last_used_at.is_(None), tokens.c.last_used_at < NOW - _USE_NOTED_EVERY)
_KNOWN_TOKEN = _TOKENS.add_columns(
    tokens.c.sha256, users.c.role, users.c.active, _MEMBERSHIPS, _WAS_USED.label("is_use_to_note")
).join(users, users.c.name == tokens.c.user_name)
_KNOWN_SESSION = (
    select(
        sessions,
        users.c.role,
        users.c.active,
        _MEMBERSHIPS,
        tokens.c.expires_at.label("token_expires_at"),
        (sessions.c.last_used_at < NOW - _USE_NOTED_EVERY).label("is_use_to_note"),
    )
    .join(users, users.c.name == sessions.c.user_name)
    .outerjoin(tokens, tokens.c.id == sessions.c.token)
    .where(sessions.c.expires_at > NOW, tokens.c.revoked_at.is_(None))
)
_ADMINS = select(users.c.name).where(users.c.role == Role.ADMIN.value, users.c.active)
_AUDIT = select(*(column for column in audit.c if column.name != "user_name")).add_columns(
    audit.c.user_name.label("user")
)


class AccountQueries(Session):
    """The part of an AccountStore that has the accounts themselves."""

    def find_token(self, token_id: str) -> KnownToken | None:
        with self._statements() as connection:
            row = connection.execute(_KNOWN_TOKEN.where(tokens.c.id == token_id)).first()
            if row is None:
                return None
            if row.is_use_to_note:
                use = update(tokens).where(tokens.c.id == token_id, _WAS_USED)
                connection.execute(use.values(last_used_at=NOW))
        token = _token(row)
        principal = Principal(
            token.user,
            Role(row.role),
            TokenScope(token.scope),
            frozenset(row.projects or ()),
            token.id,
            token.expires_at,
        )
        return KnownToken(token, row.sha256, row.active, principal)

    def add_session(self, session: PageSession, secret: Secret, actor: Actor) -> None:
        values = session.model_dump(include={"id", "token", "created_at", "expires_at"})
        new = insert(sessions).values(
            **values,
            user_name=session.user,
            scope=session.scope.value,
            sha256=secret.sha256,
            last_used_at=session.created_at,
        )
        with self._transaction() as connection:
            _find_user(connection, session.user)
            connection.execute(delete(sessions).where(sessions.c.expires_at <= NOW))
            connection.execute(new)
            note_audit(connection, actor, "session.begun", f"user {session.user}", scope=session.scope)

    def find_session(self, session_id: str, idle: timedelta) -> KnownSession | None:
        its = sessions.c.id == session_id
        with self._statements() as connection:
            row = connection.execute(_KNOWN_SESSION.where(its, sessions.c.last_used_at > NOW - idle)).first()
            if row is None:
                return None
            if row.is_use_to_note:
                connection.execute(update(sessions).where(its).values(last_used_at=NOW))
        principal = Principal(
            row.user_name,
            Role(row.role),
            TokenScope(row.scope),
            frozenset(row.projects or ()),
            row.token,
            row.token_expires_at,
        )
        return KnownSession(row.sha256, row.active, principal)

    def end_session(self, session_id: str, actor: Actor) -> None:
        ended = delete(sessions).where(sessions.c.id == session_id).returning(sessions.c.user_name)
        with self._transaction() as connection:
            if (row := connection.execute(ended).first()) is not None:
                note_audit(connection, actor, "session.ended", f"user {row.user_name}")

    def add_user(self, user: User, actor: Actor) -> User:
        values = {"name": user.name, "role": user.role.value, "active": user.active, "subject": user.subject}
        new = insert(users).values(**values, created_at=NOW).on_conflict_do_nothing(index_elements=["name"])
        with self._transaction() as connection:
            if connection.execute(new.returning(users.c.name)).first() is None:
                raise UserExists(user.name)
            for project in user.projects:
                require_project(connection, project)
                connection.execute(insert(members).values(project=project, user_name=user.name))
            note_audit(
                connection, actor, "user.added", f"user {user.name}", role=user.role, projects=user.projects
            )
            return _find_user(connection, user.name)

    def get_user(self, name: str) -> User:
        with self._statements() as connection:
            return _find_user(connection, name)

    def users(self) -> Sequence[User]:
        with self._statements() as connection:
            return [_user(row) for row in connection.execute(_USERS.order_by(users.c.name))]

    def change_user(
        self,
        name: str,
        actor: Actor,
        *,
        role: Role | None = None,
        active: bool | None = None,
        subject: str | None = None,
    ) -> User:
        changes: dict[str, Any] = {} if role is None else {"role": role.value}
        changes |= {} if active is None else {"active": active}
        changes |= {} if subject is None else {"subject": subject}
        with self._transaction() as connection:
            if changes:
                # Two that take the role from each other wait here, so that one of them is left.
                locked = connection.execute(_ADMINS.order_by(users.c.name).with_for_update())
                others = {row.name for row in locked} - {name}
                before = _find_user(connection, name)
                keeps = (role or before.role) is Role.ADMIN and active is not False
                if before.role is Role.ADMIN and before.active and not keeps and not others:
                    raise LastAdmin(name)
                if subject is not None:
                    _check_subject(connection, name, subject)
                connection.execute(update(users).where(users.c.name == name).values(**changes))
                if active is False or subject not in (None, before.subject):
                    connection.execute(delete(sessions).where(sessions.c.user_name == name))
                note_audit(connection, actor, "user.changed", f"user {name}", **changes)
            return _find_user(connection, name)

    def admit(self, grant: Grant, actor: Actor) -> User:
        new = insert(users).values(
            name=grant.name, role=grant.role.value, subject=grant.subject, created_at=NOW
        )
        known = select(users.c.name).where(users.c.subject == grant.subject).with_for_update()
        with self._transaction() as connection:
            # The admins first, as in `change_user`: so two that wait for each other are no deadlock.
            connection.execute(_ADMINS.order_by(users.c.name).with_for_update())
            row = connection.execute(known).first()
            is_new = row is None and bool(
                connection.execute(new.on_conflict_do_nothing().returning(users.c.name)).first()
            )
            if row is None and not is_new:
                raise SubjectDiffers(grant.name, grant.subject)
            user = _find_user(connection, grant.name if row is None else row.name)
            actor = replace(actor, user=user.name)
            if is_new:
                note_audit(
                    connection, actor, "user.added", f"user {user.name}", role=grant.role, by="provider"
                )
            if user.active:
                _adjust(connection, user, grant, actor, is_new=is_new)
            return _find_user(connection, user.name)

    def add_project(self, name: str, actor: Actor) -> Project:
        new = insert(projects).values(name=name, created_at=NOW)
        new = new.on_conflict_do_nothing(index_elements=["name"]).returning(projects.c.name)
        with self._transaction() as connection:
            if connection.execute(new).first() is None:
                raise ProjectExists(name)
            note_audit(connection, actor, "project.added", f"project {name}")
            return _find_project(connection, name)

    def projects(self) -> Sequence[Project]:
        with self._statements() as connection:
            return [_project(row) for row in connection.execute(_PROJECTS.order_by(projects.c.name))]

    def change_members(
        self, project: str, actor: Actor, *, add: Sequence[str] = (), remove: Sequence[str] = ()
    ) -> Project:
        with self._transaction() as connection:
            require_project(connection, project)
            for name in (*add, *remove):
                _find_user(connection, name)
            for name in add:
                new = insert(members).values(project=project, user_name=name)
                connection.execute(new.on_conflict_do_nothing())
            gone = delete(members).where(members.c.project == project, members.c.user_name.in_(remove))
            connection.execute(gone)
            note_audit(connection, actor, "project.members", f"project {project}", added=add, removed=remove)
            return _find_project(connection, project)

    def add_token(self, token: Token, secret: Secret, actor: Actor) -> Token:
        values = token.model_dump(include={"id", "name", "created_at", "expires_at"})
        new = insert(tokens).values(
            **values, user_name=token.user, scope=token.scope.value, sha256=secret.sha256
        )
        with self._transaction() as connection:
            _find_user(connection, token.user)
            # Two that make one at once come one after the other.
            connection.execute(select(users.c.name).where(users.c.name == token.user).with_for_update())
            if connection.execute(_VALID_TOKENS.where(_belongs_to(token.user))).scalar_one() >= MAX_TOKENS:
                raise TooManyTokens(token.user, MAX_TOKENS)
            connection.execute(new)
            note_audit(
                connection,
                actor,
                "token.created",
                f"token {token.id}",
                user=token.user,
                name=token.name,
                scope=token.scope,
                expires_at=token.expires_at,
            )
        return token

    def tokens(self, user: str | None = None) -> Sequence[Token]:
        wanted = _TOKENS if user is None else _TOKENS.where(tokens.c.user_name == user)
        with self._statements() as connection:
            return [_token(row) for row in connection.execute(wanted.order_by(tokens.c.created_at.desc()))]

    def revoke_token(self, token_id: str, actor: Actor, *, user: str | None = None) -> Token:
        its = tokens.c.id == token_id if user is None else (tokens.c.id == token_id) & _belongs_to(user)
        with self._transaction() as connection:
            revoked = update(tokens).where(its, tokens.c.revoked_at.is_(None)).values(revoked_at=NOW)
            is_new = connection.execute(revoked.returning(tokens.c.id)).first() is not None
            row = connection.execute(_TOKENS.where(its)).first()
            if row is None:
                raise TokenNotFound(token_id[:64])
            if is_new:
                connection.execute(delete(sessions).where(sessions.c.token == token_id))
                note_audit(connection, actor, "token.revoked", f"token {token_id}", user=row.user)
            return _token(row)

    def note(self, entries: Sequence[AuditEntry]) -> None:
        if not entries:
            return
        with self._statements() as connection:
            connection.execute(insert(audit), [{**_values(entry), "at": entry.at} for entry in entries])

    def audit(
        self,
        *,
        user: str | None = None,
        action: str | None = None,
        object: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> AuditPage:
        wanted: Select[Any] = _AUDIT.order_by(audit.c.id.desc()).limit(limit + 1)
        if user is not None:
            wanted = wanted.where(audit.c.user_name == user)
        if action is not None:
            wanted = wanted.where(audit.c.action.startswith(action, autoescape=True))
        if object is not None:
            wanted = wanted.where(audit.c.object == object)
        if cursor is not None:
            wanted = wanted.where(audit.c.id < checked_cursor(cursor))
        with self._statements() as connection:
            found = [_entry(row) for row in connection.execute(wanted)]
        return AuditPage(found[:limit], str(found[limit - 1].id) if len(found) > limit else None)


def _adjust(connection: Connection, user: User, grant: Grant, actor: Actor, *, is_new: bool) -> None:
    """Give the user the role and the projects that the provider's groups say, or that a new one gets.

    The caller has locked the admins.
    """
    if not (is_new or grant.is_kept):
        return
    others = _ADMINS.where(users.c.name != user.name).limit(1)
    is_last_admin = user.role is Role.ADMIN and not connection.execute(others).first()
    if grant.role is not user.role and not is_last_admin:
        connection.execute(update(users).where(users.c.name == user.name).values(role=grant.role.value))
        note_audit(connection, actor, "user.changed", f"user {user.name}", role=grant.role, by="provider")
    for project in sorted(grant.projects.difference(user.projects)):
        made = insert(projects).values(name=project, created_at=NOW).on_conflict_do_nothing()
        if connection.execute(made.returning(projects.c.name)).first() is not None:
            note_audit(connection, actor, "project.added", f"project {project}", by="provider")
        entered = insert(members).values(project=project, user_name=user.name).on_conflict_do_nothing()
        connection.execute(entered)
        _note_members(connection, actor, project, added=[user.name])
    for project in sorted(grant.managed.difference(grant.projects).intersection(user.projects)):
        its = (members.c.user_name == user.name) & (members.c.project == project)
        connection.execute(delete(members).where(its))
        _note_members(connection, actor, project, removed=[user.name])


def _note_members(
    connection: Connection,
    actor: Actor,
    project: str,
    *,
    added: Sequence[str] = (),
    removed: Sequence[str] = (),
) -> None:
    details = {"added": added, "removed": removed, "by": "provider"}
    note_audit(connection, actor, "project.members", f"project {project}", **details)


def _check_subject(connection: Connection, name: str, subject: str) -> None:
    """Raises SubjectTaken where another user has it."""
    row = connection.execute(select(users.c.name).where(users.c.subject == subject)).first()
    if row is not None and row.name != name:
        raise SubjectTaken(subject, row.name)


def _belongs_to(user: str) -> Any:
    return tokens.c.user_name == user


def _find_user(connection: Connection, name: str) -> User:
    row = connection.execute(_USERS.where(users.c.name == name)).first()
    if row is None:
        raise UserNotFound(name[:64])
    return _user(row)


def require_project(connection: Connection, name: str) -> None:
    if connection.execute(select(projects.c.name).where(projects.c.name == name)).first() is None:
        raise ProjectNotFound(name[:64])


def _find_project(connection: Connection, name: str) -> Project:
    return _project(connection.execute(_PROJECTS.where(projects.c.name == name)).one())


def _user(row: Row[Any]) -> User:
    return User.model_validate({**_mapping(row), "projects": row.projects or ()})


def _project(row: Row[Any]) -> Project:
    return Project.model_validate({**_mapping(row), "members": row.members or ()})


def _token(row: Row[Any]) -> Token:
    return Token.model_validate(_mapping(row))


def _entry(row: Row[Any]) -> AuditEntry:
    return AuditEntry.model_validate({**_mapping(row), "details": from_json(row.details)})


def _mapping(row: Row[Any]) -> dict[str, Any]:
    return dict(row._mapping)  # pyright: ignore[reportPrivateUsage] # Public, by SQLAlchemy's documentation.


def note_audit(connection: Connection, actor: Actor, action: str, about: str, **details: Any) -> None:
    told = {name: value for name, value in details.items() if value not in (None, (), [])}
    entry = AuditEntry(
        user=actor.user,
        token=actor.token,
        action=action,
        object=about,
        details=told,
        address=actor.address,
        correlation_id=actor.correlation_id,
    )
    connection.execute(insert(audit).values(**_values(entry), at=NOW))


def _values(entry: AuditEntry) -> dict[str, Any]:
    return {
        **entry.model_dump(include={"token", "action", "object", "address", "correlation_id"}),
        "user_name": entry.user,
        "details": to_json(entry.details, fallback=str)
        .decode()
        .replace("\\u0000", "\N{REPLACEMENT CHARACTER}"),
    }


def checked_cursor(cursor: str) -> int:
    if not (cursor.isascii() and cursor.isdigit() and len(cursor) <= 18):
        sentence = "The cursor is not one that this listing gave; leave it out to begin with the first page."
        raise Rejected(sentence, [Problem("/cursor", sentence)])
    return int(cursor)
