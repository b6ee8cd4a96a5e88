"""Sends news: claims deliveries that are due, sends each, and notes what came of it.

Several senders may run at once, in one reconciler each. A delivery is sent at least once: a sender that dies
between sending and noting has its claim run out, and another one sends the same message again, with the same
`webhook-id`.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from email.utils import parsedate_to_datetime
from functools import partial
from importlib.metadata import version
from typing import Any
from urllib.parse import urlsplit

import anyio
import httpcore
import httpx
import structlog
from anyio import to_thread
from pydantic_core import from_json

from core.errors import Unavailable
from core.news.addresses import AddressRefused, NameUnknown, Resolve, checked_address, resolve
from core.news.channels import send_by_apprise
from core.news.store import NewsStore
from core.news.webhook import CLAIM, TEST, Due, Outcome, shown_url, signed_headers
from core.settings import Networks

log = structlog.get_logger()

# Deliveries under way: by HTTP, and by Apprise, which takes a process of 70 MB for each.
_MOST_HTTP, _MOST_APPRISE = 64, 4
_EVERY_S, _PAUSE_IN_OUTAGE_S = 0.5, 2.0
# From the connection to the whole head of the answer; the body is not read.
TIMEOUT_S = 10.0
_ASKS_FOR_A_WAIT = (429, 503)


class AddressBackend(httpcore.AsyncNetworkBackend):
    """Connects to the address that was checked, whatever its name means later."""

    def __init__(self, allowed: Networks, resolver: Resolve = resolve) -> None:
        self._allowed = allowed
        self._resolver = resolver
        # Its class is hidden from type checkers where anyio may be missing.
        self._backend: Any = httpcore.AnyIOBackend()

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        address = await checked_address(host, port, self._allowed, self._resolver)
        return await self._backend.connect_tcp(address, port, timeout, local_address, socket_options)

    async def sleep(self, seconds: float) -> None:
        await self._backend.sleep(seconds)


@dataclass(frozen=True)
class Head:
    """What counts of an answer. location, retry_after: headers, empty where they are missing."""

    status: int
    location: str = ""
    retry_after: str = ""


@dataclass
class Post:
    """Sends a delivery, by HTTP or by Apprise. timeout_s: for the whole of an HTTP request."""

    allowed: Networks
    resolver: Resolve = resolve
    timeout_s: float = TIMEOUT_S

    def __post_init__(self) -> None:
        # SSL_CERT_FILE names other authorities.
        self._tls = httpx.create_ssl_context()

    async def send(self, due: Due) -> Outcome:
        if due.webhook.is_http:
            return await self._by_http(due)
        title, body = words_of(from_json(due.document))
        url = due.webhook.url.get_secret_value()
        problem = await to_thread.run_sync(send_by_apprise, url, title, body, self.allowed)
        return Outcome(error=problem and f"It was not sent: {problem}.")

    async def _by_http(self, due: Due) -> Outcome:
        try:
            with anyio.fail_after(self.timeout_s):
                return outcome_of(await self._head(due))
        except TimeoutError:
            return Outcome(error=f"It did not answer within {self.timeout_s:g} s.")
        except (AddressRefused, NameUnknown) as error:
            return Outcome(error=str(error))
        except (httpcore.NetworkError, httpcore.ProtocolError, OSError) as error:
            return Outcome(error=f"The connection failed: {str(error)[:200] or type(error).__name__}.")

    async def _head(self, due: Due) -> Head:
        url, body = httpx.URL(due.webhook.url.get_secret_value()), due.document.encode()
        place = httpcore.URL(scheme=url.raw_scheme, host=url.raw_host, port=url.port, target=url.raw_path)
        now = datetime.now(UTC)
        headers: dict[bytes | str, bytes | str] = {
            "content-type": "application/json",
            "user-agent": f"gaitway/{version('gaitway')}",
        }
        headers |= signed_headers(due.message, now, body, due.webhook.secrets_at(now))
        pool = httpcore.AsyncConnectionPool(
            self._tls, network_backend=AddressBackend(self.allowed, self.resolver)
        )
        async with pool, pool.stream("POST", place, headers=headers, content=body) as answer:
            said = {name.lower(): value.decode("latin-1") for name, value in answer.headers}
            return Head(answer.status, said.get(b"location", ""), said.get(b"retry-after", ""))


def outcome_of(head: Head) -> Outcome:
    """What an answer means: any 2xx is success, 410 ends the webhook, all others are tried again."""
    status = head.status
    if 200 <= status < 300:
        return Outcome(answer=status)
    if status == 410:
        error = "The receiver answered 410 Gone, so nothing more is sent to it."
        return Outcome(error=error, answer=status, is_final=True, stops=True)
    if 300 <= status < 400:
        return Outcome(
            error=f"It redirects{_place_of(head.location)}; redirects are not followed.", answer=status
        )
    wait = wait_of(head.retry_after, datetime.now(UTC)) if status in _ASKS_FOR_A_WAIT else None
    return Outcome(error=f"It answered {status}.", answer=status, wait=wait)


def wait_of(retry_after: str, now: datetime) -> timedelta | None:
    """What a Retry-After asks for, in seconds or until a date; None where it says neither."""
    try:
        if retry_after.strip().isdecimal():
            return timedelta(seconds=int(retry_after))
        at = parsedate_to_datetime(retry_after)
        return max(timedelta(), (at if at.tzinfo else at.replace(tzinfo=UTC)) - now)
    except (ValueError, OverflowError):
        return None


def _place_of(location: str) -> str:
    """Where a redirect leads, without what may be a secret; nothing for another path of the same host."""
    try:
        return f" to {shown_url(location)[:200]}" if urlsplit(location).scheme else ""
    except ValueError:
        return ""


_HAPPENED: Mapping[str, str] = {
    "started": "has started",
    "succeeded": "has succeeded",
    "failed": "has failed",
    "cancelled": "was cancelled",
    "attempt_lost": "has lost an attempt, and is tried again",
}


def words_of(message: dict[str, Any]) -> tuple[str, str]:
    """A title and a text for people."""
    about = message["data"]
    if message["type"] == TEST:
        return "Gaitway: a test", f"The webhook {about['webhook']} of the project {about['project']} works."
    kind, _, event = message["type"].partition(".")
    happened = _HAPPENED.get(event, event)
    name = about["name"] or about["id"]
    facts = (about["message"], f"{about['environment']}, project {about['project']}, {kind} {about['id']}")
    return f"{name} {happened}", "\n".join(filter(None, facts))


class Sender:
    """Call `serve` in a thread of its own."""

    def __init__(self, store: NewsStore, post: Post, every_s: float = _EVERY_S) -> None:
        self._store = store
        self._post = post
        self._every_s = every_s
        # By project and name, and by whether they are HTTP.
        self._of_one = Counter[tuple[str, str]]()
        self._of_kind = Counter[bool]()

    def run(self) -> None:
        """Never returns."""
        anyio.run(self.serve)

    async def serve(self) -> None:
        async with anyio.create_task_group() as tasks:
            while True:
                try:
                    for due in await self._claimed():
                        self._of_one[_key(due)] += 1
                        self._of_kind[due.webhook.is_http] += 1
                        tasks.start_soon(self._deliver, due)
                except Unavailable as error:
                    log.warning("news_waits", error=error.detail)
                    await anyio.sleep(_PAUSE_IN_OUTAGE_S)
                except Exception:  # A defect must not end the reconciler, of which this is a thread.
                    log.exception("news_crashed")
                    await anyio.sleep(_PAUSE_IN_OUTAGE_S)
                await anyio.sleep(self._every_s)

    async def _claimed(self) -> Sequence[Due]:
        while await to_thread.run_sync(self._store.spread_news):
            pass
        busy = [*self._of_one]  # A claim takes as many of one webhook as may be under way.
        claimed: list[Due] = []
        for is_http, most in ((True, _MOST_HTTP), (False, _MOST_APPRISE)):
            if (free := most - self._of_kind[is_http]) > 0:
                claim = partial(self._store.claim_deliveries, free, is_http=is_http, but_not=busy)
                claimed += await to_thread.run_sync(claim)
        return claimed

    async def _deliver(self, due: Due) -> None:
        try:
            outcome = await self._post.send(due)
        except Exception:  # A defect must not end the sender: the other webhooks are served.
            log.exception("delivery_crashed", delivery=due.id)
            outcome = Outcome(error="The service itself failed on this; its log says why.")
        log.info(
            "news_sent",
            delivery=due.id,
            webhook=due.webhook.name,
            project=due.webhook.project,
            attempt=due.attempt,
            answer=outcome.answer,
            error=outcome.error,
        )
        try:
            await self._note(due, outcome)
        finally:
            self._of_kind[due.webhook.is_http] -= 1
            self._of_one -= Counter([_key(due)])  # Drops one at 0.

    async def _note(self, due: Due, outcome: Outcome) -> None:
        """Through an outage; once the claim has run out, somebody sends it again anyway."""
        with anyio.move_on_after(CLAIM.total_seconds()):
            while True:
                try:
                    return await to_thread.run_sync(self._store.note_outcome, due, outcome)
                except Unavailable:
                    await anyio.sleep(_PAUSE_IN_OUTAGE_S)
                except Exception:
                    log.exception("news_not_noted", delivery=due.id)
                    return None


def _key(due: Due) -> tuple[str, str]:
    return due.webhook.project, due.webhook.name
