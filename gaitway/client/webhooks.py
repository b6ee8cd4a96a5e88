# Made by .ci/make_client.py: change gaitway/async_client/webhooks.py instead.
"""Webhooks of a project, and what was sent to them."""

from collections.abc import Iterator, Sequence

from gaitway.addresses import path_of
from gaitway.client.connection import Connection
from gaitway.schema import DeliveryView, NewWebhookView, WebhookView


class Webhooks(Connection):
    """The methods about who is told of jobs."""

    def add_webhook(
        self,
        name: str,
        url: str,
        *,
        project: str = "default",
        events: Sequence[str] | None = None,
        jobs: str = "all",
        secret: str | None = None,
    ) -> NewWebhookView:
        """Tell an HTTP receiver or an Apprise address of a project's jobs; its `secret` is shown this once.

        events: such as `job.failed`; by default all ends. jobs: `all`, `own`, or those that are `named` by
        `notify`. secret: `whsec_…`; by default a fresh one. Raises Rejected, NotFound, Conflict.
        """
        document = {"name": name, "url": url, "events": events and [*events], "jobs": jobs, "secret": secret}
        given = {field: value for field, value in document.items() if value is not None}
        return self._post(_path(project), NewWebhookView, json=given, once=True)

    def webhooks(self, project: str = "default") -> Sequence[WebhookView]:
        """Those of the project, without their secrets. Raises NotFound."""
        return self._items(_path(project), WebhookView)

    def change_webhook(
        self,
        name: str,
        *,
        project: str = "default",
        url: str | None = None,
        events: Sequence[str] | None = None,
        jobs: str | None = None,
        active: bool | None = None,
    ) -> WebhookView:
        """Change what is given; the rest stays. active: False stops it; True starts it again.

        Raises Rejected, NotFound.
        """
        document = {"url": url, "events": events and [*events], "jobs": jobs, "active": active}
        given = {field: value for field, value in document.items() if value is not None}
        answer = self._request("PATCH", _path(project, name), json=given)
        return WebhookView.model_validate_json(answer.content)

    def rotate_secret(self, name: str, *, project: str = "default") -> NewWebhookView:
        """Sign by a new `secret`, shown this once; the old one signs beside it for a day.

        Raises NotFound; Conflict for one of Apprise.
        """
        return self._post(_path(project, name, "rotate"), NewWebhookView, once=True)

    def delete_webhook(self, name: str, *, project: str = "default") -> None:
        """Send nothing more to it, and forget what was sent. Raises NotFound."""
        self._request("DELETE", _path(project, name))

    def test_webhook(self, name: str, *, project: str = "default") -> DeliveryView:
        """Send it a test within a second; `deliveries` shows what comes of it. Raises NotFound."""
        return self._post(_path(project, name, "test"), DeliveryView, once=True)

    def deliveries(
        self, name: str, *, project: str = "default", limit: int | None = None
    ) -> Iterator[DeliveryView]:
        """What was sent to a webhook in the last week, the newest first. Raises NotFound."""
        return self._all(_path(project, name, "deliveries"), DeliveryView, limit, {})

    def resend(self, delivery: int) -> DeliveryView:
        """Send the message again, as a new delivery; the old one ends if it waits. Raises NotFound."""
        return self._post(path_of("deliveries", str(delivery), "resend"), DeliveryView, once=True)

    def job_deliveries(self, job_id: str) -> Sequence[DeliveryView]:
        """The newest messages about a job, of the last week. Raises NotFound."""
        return self._items(self._job_path(job_id, "deliveries"), DeliveryView)


def _path(project: str, *parts: str) -> str:
    return path_of("projects", project, "webhooks", *parts)
