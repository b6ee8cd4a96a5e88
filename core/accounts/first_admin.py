"""The first admin of a service: made from beside it, since nobody could ask it to."""

import os
import re
from collections.abc import Generator
from contextlib import contextmanager
from getpass import getuser
from pathlib import Path
from typing import TextIO

from core.accounts.principal import NAME, Role, TokenScope
from core.accounts.store import AccountStore, Actor, Token, User
from core.accounts.tokens import Secret, new_secret
from core.errors import UserExists


def first_admin(store: AccountStore, name: str, *, anyway: bool = False) -> Secret | None:
    """An admin's token for this user; None if there is an active admin already, who makes all others.

    anyway: although there is one, who may have lost the token.

    A user of this name becomes the admin. Raises ValueError for a name that no user can have.
    """
    if re.fullmatch(NAME, name) is None:
        raise ValueError(f"{name!r} cannot be a user's name: small letters, digits and ._@- (63 at most).")
    if not anyway and any(user.role is Role.ADMIN and user.active for user in store.users()):
        return None
    actor, secret = Actor(), new_secret()
    try:
        store.add_user(User(name=name, role=Role.ADMIN, created_at=store.now()), actor)
    except UserExists:
        store.change_user(name, actor, role=Role.ADMIN, active=True)
    token = Token(id=secret.id, user=name, name="first admin", scope=TokenScope.ADMIN, created_at=store.now())
    store.add_token(token, secret, actor)
    return secret


def name_here() -> str:
    """The name of this system's user, if a user of the service may have it; otherwise `admin`."""
    try:
        name = getuser().lower()
    except (OSError, KeyError):  # In a container there need not be one.
        return "admin"
    return name if re.fullmatch(NAME, name) else "admin"


@contextmanager
def new_file(path: Path) -> Generator[TextIO]:
    """A new file that its owner alone can read; where nothing is written to it, it is removed again.

    Raises OSError, also where it exists.
    """
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        try:
            yield file
        finally:
            if file.tell() == 0:
                path.unlink()
