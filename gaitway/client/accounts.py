# Made by .ci/make_client.py: change gaitway/async_client/accounts.py instead.
"""Users, projects, tokens, quotas and the audit log."""

from collections.abc import Iterator, Sequence

from gaitway.addresses import path_of
from gaitway.client.connection import Connection
from gaitway.schema import (
    AuditView,
    NewTokenView,
    ProjectView,
    QuotaView,
    TokenView,
    UserView,
    WhoView,
    WorkerSettingsView,
)


class Accounts(Connection):
    """The methods about who may do what."""

    def whoami(self) -> WhoView:
        """Whose token this client sends, and what it may do."""
        return self._get("/whoami", WhoView)

    def create_token(
        self,
        scope: str,
        *,
        name: str = "",
        user: str | None = None,
        expires_in_days: int | None = 90,
    ) -> NewTokenView:
        """Make a token of the scope `read`, `submit`, `admin` or `worker`; its `secret` is shown this once.

        user: by default oneself; only an admin makes tokens for others. expires_in_days: None is never.
        """
        document = {"scope": scope, "name": name, "user": user, "expires_in_days": expires_in_days}
        return self._post("/tokens", NewTokenView, json=document, once=True)

    def tokens(self, user: str | None = None) -> Sequence[TokenView]:
        """One's own tokens, an admin's call all, or those of a user; without their secrets."""
        return self._items("/tokens", TokenView, params={"user": user} if user else {})

    def revoke_token(self, token_id: str) -> None:
        """Within two seconds nothing accepts it any more. Raises NotFound."""
        self._request("DELETE", path_of("tokens", token_id))

    def add_user(
        self, name: str, role: str = "submitter", *, projects: Sequence[str] = ("default",)
    ) -> UserView:
        """Add a `viewer`, `submitter` or `admin`. Raises Conflict where the name is taken."""
        return self._post(
            "/users", UserView, json={"name": name, "role": role, "projects": [*projects]}, once=True
        )

    def users(self) -> Sequence[UserView]:
        """All users, for an admin."""
        return self._items("/users", UserView)

    def change_user(
        self, name: str, *, role: str | None = None, active: bool | None = None, subject: str | None = None
    ) -> UserView:
        """Give a user another role, disable or enable them, or link them to an account of the identity
        provider. Raises NotFound, Conflict."""
        changes = {"role": role, "active": active, "subject": subject}
        answer = self._request("PATCH", path_of("users", name), json=changes)
        return UserView.model_validate_json(answer.content)

    def projects(self) -> Sequence[ProjectView]:
        """One's projects, with their members; an admin's call all."""
        return self._items("/projects", ProjectView)

    def add_project(self, name: str) -> ProjectView:
        """Add a project. Raises Conflict where the name is taken."""
        return self._post("/projects", ProjectView, json={"name": name}, once=True)

    def change_members(
        self, project: str, *, add: Sequence[str] = (), remove: Sequence[str] = ()
    ) -> ProjectView:
        """Let users enter a project, or leave it. Raises NotFound, and Rejected for an unknown user."""
        document = {"add": [*add], "remove": [*remove]}
        answer = self._request("PATCH", path_of("projects", project), json=document)
        return ProjectView.model_validate_json(answer.content)

    def quotas(self) -> Sequence[QuotaView]:
        """Those that were set for oneself and one's projects, with what is used; an admin's call all."""
        return self._items("/quotas", QuotaView)

    def set_quota(  # noqa: PLR0913 # What a quota has.
        self,
        kind: str,
        name: str,
        *,
        weight: float = 1.0,
        running: int | None = None,
        queued: int | None = None,
        gpu_hours: float | None = None,
        bytes: int | None = None,
        highest_priority: str = "high",
    ) -> QuotaView:
        """Set the whole quota of a `user` or a `project`: what is None has no limit. For an admin.

        weight: of its share where turns are given. running, queued: jobs at once. gpu_hours: in seven days.
        highest_priority: of the jobs that they submit: `low`, `normal` or `high`.
        Raises Rejected, NotFound.
        """
        document = {"weight": weight, "running": running, "queued": queued}
        document |= {"gpu_hours": gpu_hours, "bytes": bytes, "highest_priority": highest_priority}
        answer = self._request("PUT", path_of("quotas", kind, name), json=document)
        return QuotaView.model_validate_json(answer.content)

    def remove_quota(self, kind: str, name: str) -> None:
        """No limits any more, and a weight of 1. Raises NotFound where none was set."""
        self._request("DELETE", path_of("quotas", kind, name))

    def worker_settings(self) -> WorkerSettingsView:
        """What a worker on another machine needs to join; for a token of the scope `worker` alone."""
        return self._get("/workers/settings", WorkerSettingsView)

    def audit(
        self,
        *,
        user: str | None = None,
        action: str | None = None,
        object: str | None = None,
        limit: int | None = None,
    ) -> Iterator[AuditView]:
        """What was done, the newest first, for an admin. action: its beginning; object: kind and id."""
        filters = {"user": user, "action": action, "object": object}
        return self._all(
            "/audit", AuditView, limit, {name: value for name, value in filters.items() if value is not None}
        )
