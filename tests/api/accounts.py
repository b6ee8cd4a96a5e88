"""A service with accounts: users of each role, their tokens of each scope, and clients that send them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from typing import Any

import httpx
from fastapi import FastAPI

from api.dependencies import Service
from core.accounts.principal import Role, TokenScope
from core.accounts.store import Actor, Token, User
from core.accounts.tokens import Secret, new_secret
from tests.api.conftest import NOON, NOWHERE, Stack

NOBODY = Actor()
# Who is in which project; `root` is an admin, and in none.
USERS: dict[str, tuple[Role, tuple[str, ...]]] = {
    "root": (Role.ADMIN, ()),
    "ann": (Role.SUBMITTER, ("a",)),
    "amy": (Role.SUBMITTER, ("a",)),
    "bob": (Role.SUBMITTER, ("b",)),
    "two": (Role.SUBMITTER, ("a", "b")),
    "vic": (Role.VIEWER, ("a",)),
}


@dataclass
class Lab:
    """clients: those that were asked for."""

    app: FastAPI
    stack: Stack
    service: Service
    clients: dict[tuple[str, TokenScope], httpx.Client] = field(
        default_factory=dict[tuple[str, TokenScope], httpx.Client]
    )

    def token(
        self, user: str, scope: TokenScope = TokenScope.ADMIN, *, lives: timedelta | None = None
    ) -> Secret:
        secret = new_secret()
        expires_at = None if lives is None else self.stack.store.now() + lives
        token = Token(id=secret.id, user=user, name="", scope=scope, created_at=NOON, expires_at=expires_at)
        self.stack.store.add_token(token, secret, NOBODY)
        return secret

    def of(self, user: str, scope: TokenScope = TokenScope.ADMIN) -> httpx.Client:
        """A client with a token of this user."""
        if (user, scope) not in self.clients:
            self.clients[user, scope] = self.with_token(self.token(user, scope).text)
        return self.clients[user, scope]

    def with_token(self, text: str) -> httpx.Client:
        return self.with_header(f"Bearer {text}")

    def with_header(self, authorization: str) -> httpx.Client:
        headers = {"Authorization": authorization}
        url = f"http://127.0.0.1:{self.stack.port}"
        return httpx.Client(base_url=url, headers=headers, timeout=20, verify=False)  # noqa: S501


@contextmanager
def opened(app: FastAPI, stack: Stack, **changes: Any) -> Iterator[Lab]:
    """The stack's service, with accounts. changes: of its settings."""
    settings = NOWHERE.model_copy(update={"accounts": True, **changes})
    parts = stack.service
    service = Service(settings, parts.store, parts.queue, parts.objects)
    app.state.service = service
    for project in ("a", "b"):
        stack.store.add_project(project, NOBODY)
    for name, (role, projects) in USERS.items():
        user = User(name=name, role=role, projects=projects, created_at=NOON)
        stack.store.add_user(user, NOBODY)
    lab = Lab(app, stack, service)
    yield lab
    for client in lab.clients.values():
        client.close()
    service.acknowledgements.flush()
    service.audit_log.flush()
    service.stopping = True
