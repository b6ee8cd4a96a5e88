"""PostgreSQL's errors as this service's own, in sentences that name the setting and the remedy."""

import re
import time
from collections.abc import Generator
from contextlib import contextmanager

import psycopg
from psycopg import errors
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeout

from core.errors import RecordsRefuse, RecordsUnavailable

_ADDRESS = "GAITWAY_DATABASE_URL"
_NO_POSTGRES = f"The server at {_ADDRESS} is not PostgreSQL: correct its host and port."
_NO_CONNECTION = (
    f"PostgreSQL at {_ADDRESS} has no connection left: raise its max_connections, or run fewer processes."
)
_NOT_NOW = f"PostgreSQL at {_ADDRESS} is starting or stopping: wait for it."
# These last until somebody changes a setting. Before there is a session, a refusal has no code, only text.
_REFUSALS = {
    "password authentication failed": f"The user or the password in {_ADDRESS} is wrong: write those that "
    "PostgreSQL has, with characters such as / # @ percent-encoded.",
    "no password supplied": f"{_ADDRESS} has no password and that PostgreSQL wants one: write "
    "postgresql://USER:PASSWORD@HOST:PORT/DATABASE.",
    "Peer authentication failed": f"PostgreSQL admits the user in {_ADDRESS} only from the system account "
    "of the same name: run Gaitway under that account, or give the user a password.",
    "no pg_hba.conf entry": "PostgreSQL does not admit that user from this machine: add a line to its "
    f"pg_hba.conf; if it wants TLS, end {_ADDRESS} with ?sslmode=require.",
    "does not support SSL": f"{_ADDRESS} asks for TLS, which that PostgreSQL does not offer: end the address "
    "with ?sslmode=disable, or switch TLS on there (ssl=on).",
    # The answers of another server to a request for TLS, and to one for a session.
    "invalid response": _NO_POSTGRES,
    "expected authentication request": _NO_POSTGRES,
    "certificate": "The certificate of PostgreSQL is not trusted. Let GAITWAY_TLS_CA name a file with the "
    f"certificate of the authority that signed it; and {_ADDRESS} has to name the host as the certificate "
    "does.",
}
# These too have only text, and may pass without a change.
_NOT_LET_IN = {
    "too many clients": _NO_CONNECTION,
    "too many connections": _NO_CONNECTION,
    "connection slots are reserved": _NO_CONNECTION,
    "the database system is": _NOT_NOW,
}
_NO_USER = (
    f"PostgreSQL has no user with the name in {_ADDRESS}: create it (createuser), or name one that exists."
)
_NO_DATABASE = (
    f"PostgreSQL has no database with the name at the end of {_ADDRESS}: create it (createdb), or name "
    "another."
)
_POOLED = (
    f"{_ADDRESS} leads to a pooler that gives one session several servers: let it work by sessions "
    "(PgBouncer: pool_mode = session)."
)
_MISSING = re.compile(r'(database|role) ".*" does not exist')
_REFUSED_BY_CODE: dict[type[psycopg.Error], str] = {
    errors.InvalidPassword: _REFUSALS["password authentication failed"],
    errors.InvalidCatalogName: _NO_DATABASE,
    errors.InsufficientPrivilege: f"The user of {_ADDRESS} may not use these tables: make it the owner of "
    "the database (ALTER DATABASE … OWNER TO …).",
    errors.ReadOnlySqlTransaction: f"{_ADDRESS} leads to a standby, which takes no writes: set it to its "
    "primary's address, or end it with ?target_session_attrs=read-write.",
    errors.InvalidSqlStatementName: _POOLED,
    errors.DuplicatePreparedStatement: _POOLED,
}
_UNAVAILABLE_BY_CODE: dict[type[psycopg.Error], str] = {
    errors.UndefinedTable: "The database has no tables yet: the reconciler makes them when it starts.",
    errors.UndefinedColumn: "The database has another version's tables: the reconciler upgrades them when it "
    "starts.",
    errors.DiskFull: f"PostgreSQL at {_ADDRESS} has no room on its disk: free or add some.",
    # This process was stopped in the middle of a transaction.
    errors.IdleInTransactionSessionTimeout: f"PostgreSQL at {_ADDRESS} ended a transaction that was idle for "
    "5 s.",
    errors.QueryCanceled: f"PostgreSQL at {_ADDRESS} took longer than 1.8 s; it is overloaded.",
    errors.LockNotAvailable: f"PostgreSQL at {_ADDRESS} waited for a lock for longer than 1.5 s.",
    errors.DeadlockDetected: f"PostgreSQL at {_ADDRESS} ended one of two calls that waited for each other.",
}


class NoAnswer(psycopg.OperationalError):
    """The server accepts connections and does not answer."""


class Breaker:
    """After a call met silence, refuses calls for a second, so that callers do not queue up."""

    _REST_S = 1.0

    def __init__(self) -> None:
        self._closed_at = 0.0
        self._said = ""

    @contextmanager
    def reaching(self, *, is_large: bool = False) -> Generator[None]:
        """Turn outages into RecordsUnavailable, and what only a changed setting mends into RecordsRefuse.

        Errors of ours pass through. is_large: silence is no reason to refuse other calls.
        """
        if time.monotonic() < self._closed_at:
            raise RecordsUnavailable(self._said)
        try:
            yield
        except PoolTimeout as error:
            raise RecordsUnavailable("Too many calls wait for PostgreSQL; try again.") from error
        except (DBAPIError, psycopg.Error) as error:
            meant = meaning(error)
            if meant is None:
                raise
            if _is_silence(error) and not is_large:
                self._closed_at, self._said = time.monotonic() + self._REST_S, meant.detail
            raise meant from error


def meaning(error: Exception) -> RecordsUnavailable | None:
    """The exception to raise for an error of the driver; None for an error of ours."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    for known, sentence in _REFUSED_BY_CODE.items():
        if isinstance(cause, known):
            return RecordsRefuse(sentence)
    for known, sentence in _UNAVAILABLE_BY_CODE.items():
        if isinstance(cause, known):
            return RecordsUnavailable(sentence)
    if isinstance(cause, psycopg.OperationalError | psycopg.InterfaceError):
        return _of_no_answer(cause)
    return None


def _of_no_answer(error: psycopg.Error) -> RecordsUnavailable:
    words = str(error)
    for known, sentence in _REFUSALS.items():
        if known in words:
            return RecordsRefuse(sentence)
    for known, sentence in _NOT_LET_IN.items():
        if known in words:
            return RecordsUnavailable(sentence)
    if missing := _MISSING.search(words):
        return RecordsRefuse(_NO_DATABASE if missing[1] == "database" else _NO_USER)
    return RecordsUnavailable(
        f"PostgreSQL does not answer at {_ADDRESS}: {_short(words)}. Start it, or correct the setting."
    )


def _is_silence(error: Exception) -> bool:
    cause = error.orig if isinstance(error, DBAPIError) else error
    return isinstance(cause, NoAnswer | errors.ConnectionTimeout)


def _short(words: str) -> str:
    """The first line of a driver's message, without address and hints."""
    first = words.strip().partition("\n")[0].rpartition(" failed: ")[2]
    return first.removeprefix("FATAL:").strip().rstrip(".") or "no reason given"
