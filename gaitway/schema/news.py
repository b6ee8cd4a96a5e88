"""Webhooks, and what was sent to them."""

from datetime import datetime

from pydantic import Field

from gaitway.schema.base import DeliveryStatus, View, WhichJobs


class WebhookView(View):
    """Whom to tell of what. url: without what may be a secret of it. events: such as `job.failed`.

    owner: who made it. jobs: `all` of the project, the owner's `own`, or those that are `named` by `notify`.
    old_secret_until: until then the secret before the newest signs beside it. stopped: why it is told nothing
    any more.
    """

    project: str = Field(examples=["gaits"])
    name: str = Field(examples=["lab-chat"])
    owner: str | None = None
    url: str = Field(examples=["https://hooks.lab.edu/…"])
    events: tuple[str, ...]
    jobs: WhichJobs
    created_at: datetime
    old_secret_until: datetime | None = None
    stopped: str | None = None


class NewWebhookView(WebhookView):
    """A webhook with its new secret, which is shown this once and signs its messages; null for Apprise."""

    secret: str | None = Field(None, examples=["whsec_…"])


class DeliveryView(View):
    """A message for one webhook. message: its id, the header `webhook-id`. attempts: tries so far.

    answer: the HTTP status of the newest try; error: why that failed. next_attempt_at: null once it has
    ended.
    """

    id: int
    webhook: str
    message: str = Field(examples=["msg_5be0c1d2e35be0c1d2e35be0"])
    event: str = Field(examples=["job.succeeded"])
    job: str | None = None
    status: DeliveryStatus
    attempts: int
    created_at: datetime
    next_attempt_at: datetime | None = None
    ended_at: datetime | None = None
    answer: int | None = None
    error: str | None = None
