"""Who makes a request, and what they may do.

viewer     reads what is in their projects
submitter  also submits there, and changes, cancels and deletes what they own
admin      does all, in every project

A token acts as the lesser of its user's role and its scope: an admin's token of the scope `read` may do what
a viewer's may.
"""

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Annotated

from pydantic import Field

from core.bounds import ACCOUNT_NAME
from core.errors import Problem, Rejected

DEFAULT_PROJECT = "default"
NAME = ACCOUNT_NAME
# The name of a user or a project.
AccountName = Annotated[str, Field(pattern=f"^{NAME}$", examples=["ann"])]


class Role(StrEnum):
    """A user's rights, the least first."""

    VIEWER = "viewer"
    SUBMITTER = "submitter"
    ADMIN = "admin"

    @property
    def rank(self) -> int:
        return [*Role].index(self)


class TokenScope(StrEnum):
    """The most that a token may do. A `worker` token does nothing but join a worker."""

    READ = "read"
    SUBMIT = "submit"
    ADMIN = "admin"
    WORKER = "worker"

    @property
    def role(self) -> Role | None:
        """The role that it reaches; None for a worker's, which has none."""
        return _REACHES.get(self)


_REACHES = {
    TokenScope.READ: Role.VIEWER,
    TokenScope.SUBMIT: Role.SUBMITTER,
    TokenScope.ADMIN: Role.ADMIN,
}
SCOPE_FOR = {role: scope for scope, role in _REACHES.items()}


@dataclass(frozen=True)
class Ownership:
    """Whose a job, a sweep or a model is. owner: None if it was made without accounts."""

    owner: str | None = None
    project: str = DEFAULT_PROJECT


NOBODYS = Ownership()


@dataclass(frozen=True)
class Principal:
    """Who makes a request. user: None while the service has no accounts.

    token: the id of the token that it came with, also where the page made a session of it; None where the
    identity provider said who it is. expires_at: the end of that token. projects: those of which the user is
    a member.
    """

    user: str | None
    role: Role
    scope: TokenScope
    projects: frozenset[str] = frozenset()
    token: str | None = None
    expires_at: datetime | None = None

    @property
    def acts_as(self) -> Role | None:
        """The lesser of role and scope; None for a worker's token."""
        reached = self.scope.role
        return None if reached is None else min(reached, self.role, key=lambda role: role.rank)

    @property
    def is_admin(self) -> bool:
        return self.acts_as is Role.ADMIN

    @property
    def readable(self) -> frozenset[str] | None:
        """The projects whose jobs, sweeps and models it sees; None: all."""
        return None if self.is_admin else self.projects

    def sees(self, project: str) -> bool:
        return self.is_admin or project in self.projects

    def may_change(self, owner: str | None) -> bool:
        """Whether it may cancel or delete what this user owns."""
        return self.is_admin or (owner is not None and owner == self.user)


# Makes every request of a service without accounts.
ANYONE = Principal(None, Role.ADMIN, TokenScope.ADMIN, frozenset({DEFAULT_PROJECT}))


def project_for(principal: Principal, wanted: str | None, existing: Collection[str] = ()) -> str:
    """The project of what the principal submits. existing: all projects, for an admin.

    Raises Rejected, with the pointer `/project`, for one that does not exist or is not theirs, and where they
    have several and name none.
    """
    own = sorted(principal.projects)
    named = ", ".join(own)
    if wanted is not None:
        if wanted in (existing if principal.is_admin else own):
            return wanted
        yours = f" Yours are: {named}." if own else " You are in none: an admin adds you."
        raise _refusal(f"There is no project {wanted!r} that you may use.{yours}")
    if len(own) == 1:
        return own[0]
    if principal.is_admin:
        return DEFAULT_PROJECT
    if not own:
        raise _refusal("You are in no project: an admin adds you by `gaitway projects members`.")
    raise _refusal(f"You are in several projects: say which by `project`, one of {named}.")


def _refusal(detail: str) -> Rejected:
    return Rejected(detail, [Problem("/project", detail)])
