"""The interface of the record of webhooks, news and deliveries."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from pydantic import SecretStr

from core.accounts.store import Actor
from core.news.webhook import Change, Delivery, Due, News, Outcome, Webhook


@dataclass(frozen=True)
class DeliveryPage:
    """Some deliveries, newest first, and the cursor of the next page; None at the end."""

    deliveries: Sequence[Delivery]
    next_cursor: str | None


class NewsStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def add_webhook(self, webhook: Webhook, actor: Actor) -> Webhook:
        """Raises ProjectNotFound; WebhookExists; TooManyWebhooks where the project has MAX_WEBHOOKS."""
        ...

    def webhooks(self, project: str) -> Sequence[Webhook]:
        """Those of the project, by name. Raises ProjectNotFound."""
        ...

    def webhook(self, project: str, name: str) -> Webhook:
        """Raises WebhookNotFound."""
        ...

    def change_webhook(self, project: str, name: str, change: Change, actor: Actor) -> Webhook:
        """What waits goes to the new address. Raises WebhookNotFound."""
        ...

    def rotate_secret(self, project: str, name: str, secret: SecretStr, actor: Actor) -> Webhook:
        """Sign by this one; the one before it signs beside it for OVERLAP, and one before that no more.

        Raises WebhookNotFound; WebhookUnsigned for one of Apprise.
        """
        ...

    def remove_webhook(self, project: str, name: str, actor: Actor) -> None:
        """With its deliveries. Raises WebhookNotFound."""
        ...

    def add_test(self, project: str, name: str, news: News) -> Delivery:
        """A delivery to this webhook alone, whatever it wants to be told. Raises WebhookNotFound."""
        ...

    def webhook_of(self, delivery: int) -> Webhook:
        """The one that it is for. Raises DeliveryNotFound."""
        ...

    def resend(self, delivery: int) -> Delivery:
        """A new delivery of the same message; one that waits ends in its favour. Raises DeliveryNotFound."""
        ...

    def deliveries(
        self,
        *,
        project: str | None = None,
        webhook: str | None = None,
        job: str | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> DeliveryPage:
        """Deliveries that match, newest first. Raises Rejected for a wrong cursor."""
        ...

    def spread_news(self, limit: int = 200) -> int:
        """Make deliveries of news that has none yet; returns how many messages it took.

        A webhook whose owner is disabled or has left the project is told nothing. One transaction, which two
        callers never do for the same news.
        """
        ...

    def claim_deliveries(
        self, limit: int, *, is_http: bool, but_not: Collection[tuple[str, str]] = ()
    ) -> Sequence[Due]:
        """Take deliveries that are due; nobody else gets them for as long as CLAIM, and then somebody does.

        At most `most_at_once` of one webhook. is_http: those by HTTP; otherwise those by Apprise. but_not:
        webhooks left out, each by project and name.
        """
        ...

    def note_outcome(self, due: Due, outcome: Outcome) -> None:
        """End the delivery, or say when it is tried again. Does nothing if it was claimed again meanwhile."""
        ...
