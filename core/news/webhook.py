"""Webhooks of a project, the news that they are told, and the signature on it.

News is a message about a job or a sweep. It is written in the transaction that changes that. A sender makes a
delivery of it for each webhook that wants it, and tries each delivery until it is taken or a day has passed.
Messages and signatures are those of Standard Webhooks 1.0 (https://www.standardwebhooks.com).
"""

import base64
import binascii
import hashlib
import hmac
import random
import re
import secrets
from collections.abc import Iterable
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal, get_args
from urllib.parse import urlsplit

from pydantic import Field, SecretStr
from pydantic_core import to_json

from core.bounds import ACCOUNT_NAME
from core.documents import Stored
from core.errors import DeliveryNotFound

JobEvent = Literal["job.started", "job.succeeded", "job.failed", "job.cancelled", "job.attempt_lost"]
SweepEvent = Literal["sweep.succeeded", "sweep.failed", "sweep.cancelled"]
EVENTS: tuple[JobEvent | SweepEvent, ...] = (*get_args(JobEvent), *get_args(SweepEvent))
# Those that a webhook is told unless it says otherwise: a job or a sweep has ended.
ENDS: tuple[JobEvent | SweepEvent, ...] = (
    *("job.succeeded", "job.failed", "job.cancelled"),
    *get_args(SweepEvent),
)
TEST = "webhook.test"
WebhookName = Annotated[str, Field(pattern=f"^{ACCOUNT_NAME}$", examples=["lab-chat"])]
WhichJobs = Literal["all", "own", "named"]
DELIVERY_ID = "[0-9]{1,18}"
DeliveryStatus = Literal["waiting", "delivered", "failed"]

MAX_WEBHOOKS = 20
# By the specification.
SHORTEST_SECRET, LONGEST_SECRET = 24, 64
_PREFIX = "whsec_"

# Between two tries; after the last of them, a day after the first one, a delivery has failed.
PAUSES = tuple(
    timedelta(seconds=seconds)
    for seconds in (5, 30, 120, 600, 1800, 3600, 7200, 14_400, 18_000, 18_000, 22_645)
)
# A sender that says nothing for this long after it has claimed a delivery is taken for dead.
CLAIM = timedelta(seconds=45)
# A receiver that asks for a later try waits this long at most.
LONGEST_WAIT = timedelta(days=1)
# How long the secret before a new one signs beside it, as the specification recommends.
OVERLAP = timedelta(days=1)
# How long the log of deliveries reaches back.
KEPT = timedelta(days=7)


class Webhook(Stored):
    """Whom to tell of what. owner: who made it; None without accounts.

    url: of an HTTP receiver, or an Apprise address; it may hold a password. jobs: all of the project, those
    of the owner, or those that name it in `notify`. secret: `whsec_…`, which signs messages; None for
    Apprise. old_secret: the one before it, which signs beside it until `old_secret_until`. stopped: why it is
    told nothing any more.
    """

    project: str
    name: str
    owner: str | None = None
    url: SecretStr
    events: tuple[str, ...]
    jobs: WhichJobs
    secret: SecretStr | None = None
    old_secret: SecretStr | None = None
    old_secret_until: datetime | None = None
    created_at: datetime
    stopped: str | None = None

    @property
    def is_http(self) -> bool:
        return is_http(self.url.get_secret_value())

    def secrets_at(self, at: datetime) -> list[str]:
        """Those that sign a message now, the newest first; none for Apprise."""
        is_old_one_valid = self.old_secret_until is not None and at < self.old_secret_until
        known = [self.secret, self.old_secret if is_old_one_valid else None]
        return [secret.get_secret_value() for secret in known if secret is not None]


class Change(Stored):
    """What changes of a webhook; None stays.

    active: False stops it, which ends what waits; True starts it again, also after a 410.
    """

    url: SecretStr | None = None
    events: tuple[str, ...] | None = None
    jobs: WhichJobs | None = None
    active: bool | None = None


class News(Stored):
    """A message. id: of the message, the same at each try. notify: names of webhooks that the job names.

    document: the body as it is sent.
    """

    id: str
    event: str
    project: str
    owner: str | None = None
    job: str | None = None
    notify: tuple[str, ...] = ()
    document: str


class Delivery(Stored):
    """News for one webhook. attempts: tries so far. answer: the status of the newest HTTP answer.

    next_attempt_at: None once it has ended. error: why the newest try failed.
    """

    id: int
    webhook: str
    message: str
    event: str
    job: str | None = None
    status: DeliveryStatus
    attempts: int
    created_at: datetime
    next_attempt_at: datetime | None = None
    ended_at: datetime | None = None
    answer: int | None = None
    error: str | None = None


class Due(Stored):
    """A delivery that the caller has claimed. attempt: its number, which the outcome must name."""

    id: int
    attempt: int
    message: str
    document: str
    webhook: Webhook


class Outcome(Stored):
    """How a try ended. error: None for success. is_final: no other try can succeed.

    wait: the receiver asks that the next try comes no sooner. stops: it wants no more news at all.
    """

    error: str | None = None
    answer: int | None = None
    wait: timedelta | None = None
    is_final: bool = False
    stops: bool = False


def new_message(event: str, at: datetime, about: dict[str, Any], **facts: Any) -> News:
    """News with a fresh id. about: what the body has as `data`."""
    body = {"type": event, "timestamp": at, "data": about}
    return News(id=f"msg_{secrets.token_hex(12)}", event=event, document=to_json(body).decode(), **facts)


def new_signing_secret() -> SecretStr:
    return SecretStr(_PREFIX + base64.b64encode(secrets.token_bytes(32)).decode())


def check_signing_secret(text: str) -> str:
    """The same text. Raises ValueError."""
    size = len(_key(text))
    if not SHORTEST_SECRET <= size <= LONGEST_SECRET:
        raise ValueError(
            f"has {size} bytes after `{_PREFIX}`; {SHORTEST_SECRET} to {LONGEST_SECRET} are allowed"
        )
    return text


def _key(secret: str) -> bytes:
    try:
        if not secret.startswith(_PREFIX):
            raise ValueError
        return base64.b64decode(secret.removeprefix(_PREFIX), validate=True)
    except (ValueError, binascii.Error):
        raise ValueError(f"must be `{_PREFIX}` and then base64") from None


def signed_headers(message: str, at: datetime, body: bytes, signers: Iterable[str]) -> dict[str, str]:
    """The headers that say who sent the message and when, and prove it by a signature for each secret.

    signers: secrets, the newest first.
    """
    timestamp = str(int(at.timestamp()))
    signed = b".".join((message.encode(), timestamp.encode(), body))
    digests = [hmac.digest(_key(secret), signed, hashlib.sha256) for secret in signers]
    signature = " ".join(f"v1,{base64.b64encode(digest).decode()}" for digest in digests)
    return {"webhook-id": message, "webhook-timestamp": timestamp, "webhook-signature": signature}


def most_at_once(*, is_http: bool) -> int:
    """Deliveries of one webhook that are under way: while its receiver hangs, the others are served."""
    return 4 if is_http else 1


def pause_after(attempt: int, wait: timedelta | None = None) -> timedelta | None:
    """The time from this try, counted from 1, to the next, within a tenth at random; None after the last.

    wait: what the receiver asks for at least, of which a day counts.
    """
    if attempt > len(PAUSES):
        return None
    pause = PAUSES[attempt - 1] * random.uniform(0.95, 1.05)  # noqa: S311
    return pause if wait is None else max(pause, min(wait, LONGEST_WAIT))


def delivery_number(text: str) -> int:
    """The id that this text is. Raises DeliveryNotFound."""
    if re.fullmatch(DELIVERY_ID, text) is None:
        raise DeliveryNotFound(text[:64])
    return int(text)


def is_http(url: str) -> bool:
    """Whether the address is that of an HTTP receiver; the others are Apprise's."""
    return urlsplit(url).scheme in ("http", "https")


def shown_url(url: str) -> str:
    """The address without what may be a secret: its password, path and query."""
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https"):
        return f"{parts.scheme}://…"
    place = parts.netloc.rpartition("@")[2]
    rest = "/…" if parts.path.strip("/") or parts.query else ""
    return f"{parts.scheme}://{place}{rest}"


def wants(webhook: Webhook, news: News) -> bool:
    """Whether the webhook is told this."""
    if news.event not in webhook.events or webhook.stopped is not None:
        return False
    is_of_its_jobs = webhook.jobs == "all" or (webhook.jobs == "own" and webhook.owner == news.owner)
    return is_of_its_jobs or webhook.name in news.notify
