"""Users, projects, tokens, quotas, and the audit log."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from pydantic import Field

from gaitway.schema.base import Priority, QuotaKind, Role, TokenScope, View


class WhoView(View):
    """Who makes the request. accounts: whether the service has any; without, everybody may do everything.

    role: the user's; scope: of the token. A request may do what both allow.
    """

    accounts: bool
    user: str | None = None
    role: Role
    scope: TokenScope
    projects: tuple[str, ...] = ()
    token: str | None = None
    expires_at: datetime | None = None


class SessionView(View):
    """What the page needs before anybody is signed in. who: None if nobody is.

    provider: what the lab calls its identity provider; None: there is none, so tokens alone sign in.
    """

    accounts: bool
    provider: str | None = None
    who: WhoView | None = None


class ProviderView(View):
    """Where the page sends the browser to sign in. location: at the identity provider."""

    location: str


class UserView(View):
    """A user. subject: that of the identity provider, if the user signs in there."""

    name: str = Field(examples=["ann"])
    role: Role
    active: bool = True
    subject: str | None = None
    projects: tuple[str, ...] = ()
    created_at: datetime


class ProjectView(View):
    """A project, whose members see what is in it."""

    name: str = Field(examples=["gaits"])
    members: tuple[str, ...] = ()
    created_at: datetime


class TokenView(View):
    """A token without its secret. last_used_at: to the minute."""

    id: str = Field(examples=["5be0c1d2e3f4"])
    user: str
    name: str = ""
    scope: TokenScope
    created_at: datetime
    expires_at: datetime | None = None
    last_used_at: datetime | None = None
    revoked_at: datetime | None = None


class NewTokenView(TokenView):
    """A token that was just made. secret: shown this once."""

    secret: str = Field(examples=["gaitway_5be0c1d2e3f4_…"])


class WorkerSettingsView(View):
    """What a worker elsewhere needs. variables: of its environment; tls_ca: PEM of the stores' authority."""

    variables: Mapping[str, str]
    tls_ca: str | None = None


class QuotaUseView(View):
    """What is used of a quota. gpu_hours: of seven days, with what runs now; bytes: stored now."""

    running: int = 0
    queued: int = 0
    gpu_hours: float = 0.0
    bytes: int = 0


class QuotaView(View):
    """What a user or a project may have: kind is `user` or `project`; null: as much as they like.

    weight: of its share where turns are given. running, queued: jobs at once. gpu_hours: in seven days.
    bytes: of the files of jobs, of models and of clips. highest_priority: of the jobs that they submit.
    """

    kind: QuotaKind
    name: str = Field(examples=["gaits"])
    weight: float = 1.0
    running: int | None = None
    queued: int | None = None
    gpu_hours: float | None = None
    bytes: int | None = None
    highest_priority: Priority = "high"
    used: QuotaUseView = QuotaUseView()


class AuditView(View):
    """Something that was done. object: the kind and id of the thing; address: of the client."""

    id: int
    at: datetime
    user: str | None = None
    token: str | None = None
    action: str = Field(examples=["job.cancelled"])
    object: str | None = Field(None, examples=["job 019aa3c2f0b1-5be0c1d2e3"])
    details: Mapping[str, Any] = {}
    address: str | None = None
    correlation_id: str | None = None
