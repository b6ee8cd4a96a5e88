"""Finds out who makes a request, by its token or the page's session; counts the requests of each.

The record's answer about either is used for two seconds. So a token that is revoked, a user who is disabled
and a role that is taken away have no effect any more after two seconds, in every process.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from threading import Lock
from time import monotonic
from typing import ClassVar

from anyio import CapacityLimiter, to_thread
from fastapi import Request

from api.problems import EdgeError
from api.sessions import check_sender, session_of
from core.accounts.principal import Principal
from core.accounts.store import AccountStore, KnownToken
from core.accounts.tokens import Secret, parse

CACHED_S = 2.0
# A burst may use what was left over in this time.
_BURST_S = 10.0
_MOST_CACHED = 10_000
# Tokens that are refused cost queries, too. They are counted by address, since nobody is known.
_GUESSES_PER_SECOND = 10.0
# Threads of their own: requests may occupy all of the common pool.
_THREADS = 4
_HOW = "send `Authorization: Bearer gaitway_…`; `gaitway login` stores a token for the command"


class Unauthenticated(EdgeError):
    """The service has accounts, and the request has no token that it accepts."""

    status = 401
    code = "unauthenticated"
    title = "Who makes this request?"

    def __init__(self, detail: str, reason: str) -> None:
        super().__init__(detail, reason=reason)
        self._is_missing = reason == "missing"

    @property
    def headers(self) -> dict[str, str]:
        # RFC 6750, section 3: a request without credentials is told no error.
        return {
            "WWW-Authenticate": 'Bearer realm="gaitway"' + ', error="invalid_token"' * (not self._is_missing)
        }


class TooManyRequests(EdgeError):
    """A user makes more requests than GAITWAY_REQUESTS_PER_SECOND allows, or more tokens are refused or
    sign-ins on the page have failed from an address than are allowed (GAITWAY_SIGN_INS_PER_MINUTE)."""

    status = 429
    code = "too-many-requests"
    title = "Too many requests"

    def __init__(self, sentence: str, most: float, wait_s: float) -> None:
        super().__init__(f"{sentence.format(most=most)}; wait {wait_s:.1f} s.", most=most)
        self._wait_s = wait_s

    @property
    def headers(self) -> dict[str, str]:
        return {"Retry-After": str(max(1, round(self._wait_s + 0.5)))}


@dataclass
class _Bucket:
    """Requests that may be made at once, as of a moment."""

    left: float
    at: float


class RequestLimit:
    """A token bucket for each one who asks, in this process; thread-safe.

    most: in `period_s`, on average over `burst_s`. sentence: of the refusal, which names `most`.
    """

    def __init__(self, most: float, period_s: float, burst_s: float, sentence: str) -> None:
        self._named, self._sentence = most, sentence
        self._per_second = most / period_s
        self._most = self._per_second * burst_s
        self._buckets: dict[str, _Bucket] = {}
        self._lock = Lock()

    def count(self, who: str) -> None:
        """Raises TooManyRequests."""
        with self._lock:
            self._count(who, monotonic())

    def give_back(self, who: str) -> None:
        """Do not count the last one."""
        with self._lock:
            if (bucket := self._buckets.get(who)) is not None:
                bucket.left += 1

    def _count(self, who: str, now: float) -> None:
        bucket = self._buckets.get(who)
        if bucket is None:
            if len(self._buckets) >= _MOST_CACHED:
                self._buckets.clear()
            bucket = self._buckets[who] = _Bucket(self._most, now)
        bucket.left = min(self._most, bucket.left + (now - bucket.at) * self._per_second)
        bucket.at = now
        if bucket.left < 1:
            raise TooManyRequests(self._sentence, self._named, (1 - bucket.left) / self._per_second)
        bucket.left -= 1


class Authenticator:
    """Belongs to one event loop."""

    scheme: ClassVar[str] = "bearer"

    def __init__(self, store: AccountStore, requests_per_second: float, session_idle: timedelta) -> None:
        self._store = store
        self._session_idle = session_idle
        sentence = "You make more than {most:g} requests a second, with all your tokens together"
        self._limit = RequestLimit(requests_per_second, 1.0, _BURST_S, sentence)
        sentence = "More than {most:g} requests a second from this address have a token that is not accepted"
        self._guesses = RequestLimit(_GUESSES_PER_SECOND, 1.0, _BURST_S, sentence)
        # By the hash of the whole token, so that no secret stays in memory.
        self._known: dict[str, tuple[float, Principal]] = {}
        self._threads = CapacityLimiter(_THREADS)

    async def principal(self, request: Request) -> Principal:
        """The principal who makes the request; the request is counted.

        Raises Unauthenticated, CrossSiteRequest, TooManyRequests, RecordsUnavailable.
        """
        principal = await self.of_request(request)
        # All of a user's tokens together: anybody may make another one.
        self._limit.count(f"user {principal.user}")
        return principal

    async def of_request(self, request: Request) -> Principal:
        """The principal who made the request, by the record of now.

        Raises Unauthenticated, CrossSiteRequest, TooManyRequests, RecordsUnavailable.
        """
        address = "" if request.client is None else request.client.host
        session = None if "authorization" in request.headers else session_of(request)
        if session is None:
            return await self._remembered(_secret(request), self.of_token, address)
        check_sender(request)
        return await self._remembered(session, self.of_session, address)

    def forget(self, secret: Secret) -> None:
        """Ask the record again, for a session that has ended."""
        self._known.pop(secret.sha256, None)

    async def _remembered(
        self, secret: Secret, find: Callable[[Secret], Principal], address: str
    ) -> Principal:
        sha256 = secret.sha256
        until, principal = self._known.get(sha256, (0.0, None))
        if principal is not None and monotonic() < until:
            return principal
        # What was accepted before is no guess: others at its address may not shut it out.
        is_guess = principal is None
        if is_guess:
            self._guesses.count(address)
        until = monotonic() + CACHED_S
        try:
            principal = await to_thread.run_sync(find, secret, limiter=self._threads)
        except Unauthenticated:
            self._known.pop(sha256, None)
            is_guess = False
            raise
        finally:
            if is_guess:
                self._guesses.give_back(address)
        if len(self._known) >= _MOST_CACHED:
            self._known.clear()
        self._known[sha256] = (until, principal)
        return principal

    def of_token(self, secret: Secret) -> Principal:
        """The holder of this token, by the record of now. Raises Unauthenticated, RecordsUnavailable."""
        known = self._store.find_token(secret.id)
        # The same work for an id that does not exist.
        if not secret.matches("" if known is None else known.sha256) or known is None:
            raise Unauthenticated(f"This service does not know the token: {_HOW}.", "unknown")
        _check(known, self._store)
        return known.principal

    def of_session(self, secret: Secret) -> Principal:
        """The principal who is signed in by this session. Raises Unauthenticated, RecordsUnavailable."""
        known = self._store.find_session(secret.id, self._session_idle)
        if not secret.matches("" if known is None else known.sha256) or known is None:
            raise Unauthenticated("The session has ended: sign in again.", "session-ended")
        if not known.is_active:
            raise _disabled(str(known.principal.user))
        return known.principal


def _secret(request: Request) -> Secret:
    sent = request.headers.get("authorization")
    if sent is None:
        raise Unauthenticated(f"This service has accounts: {_HOW}.", "missing")
    scheme, _, text = sent.partition(" ")
    secret = parse(text.strip()) if scheme.lower() == Authenticator.scheme else None
    if secret is None:
        raise Unauthenticated(f"The header Authorization has no token of this form: {_HOW}.", "malformed")
    return secret


def _check(known: KnownToken, store: AccountStore) -> None:
    token = known.token
    if token.revoked_at is not None:
        raise Unauthenticated(f"The token {token.id} was revoked: ask for another one.", "revoked")
    if token.expires_at is not None and token.expires_at <= store.now():
        moment = f"{token.expires_at:%Y-%m-%d %H:%M} UTC"
        raise Unauthenticated(f"The token {token.id} expired at {moment}: make another one.", "expired")
    if not known.is_active:
        raise _disabled(token.user)


def _disabled(user: str) -> Unauthenticated:
    return Unauthenticated(f"The user {user} is disabled: ask an admin.", "disabled")
