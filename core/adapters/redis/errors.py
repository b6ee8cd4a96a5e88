"""Redis' errors as sentences that name the setting and the remedy."""

from collections.abc import Generator
from contextlib import contextmanager

from redis.exceptions import (
    AuthenticationError,
    BusyLoadingError,
    ConnectionError,
    InvalidResponse,
    MasterDownError,
    NoPermissionError,
    OutOfMemoryError,
    ReadOnlyError,
    RedisError,
    ResponseError,
    TimeoutError,
)

from core.adapters.causes import reason, tls_refusal
from core.errors import RecordsRefuse, RecordsUnavailable

_WANTS_A_PASSWORD = ("Authentication required", "HELLO must be called")
_HUNG_UP = ("Connection closed by server", "Connection reset by peer")
# Refusals that the client recognises only by their text; a pipeline puts its own words before it.
_REFUSALS = {
    "DENIED ": (
        RecordsRefuse,
        "Redis at GAITWAY_REDIS_URL is in protected mode: without a password it accepts no other machines. "
        "Give it one (requirepass) and write it into the address.",
    ),
    "DB index is out of range": (
        RecordsRefuse,
        "Redis has no database with the number at the end of GAITWAY_REDIS_URL; /0 always exists.",
    ),
    "MISCONF ": (
        RecordsUnavailable,
        "Redis at GAITWAY_REDIS_URL takes no writes, because it cannot write its own files (MISCONF): free "
        "or add space on the volume of its data folder; its own log says more.",
    ),
    "NOREPLICAS ": (
        RecordsUnavailable,
        "Redis at GAITWAY_REDIS_URL takes no writes without its replicas: start them, or lower its "
        "min-replicas-to-write.",
    ),
    "WRONGTYPE ": (
        RecordsUnavailable,
        "Something else writes into the Redis database at GAITWAY_REDIS_URL: a key of Gaitway's queue holds "
        "a wrong type (WRONGTYPE). Give Gaitway a database of its own, or empty this one (FLUSHDB): that "
        "loses no job.",
    ),
    "BUSY ": (RecordsUnavailable, "Redis at GAITWAY_REDIS_URL is busy running a script."),
}


@contextmanager
def reaching_redis() -> Generator[None]:
    """Turn outages into RecordsUnavailable, and what only a changed setting mends into RecordsRefuse.

    Also a decorator. Errors of ours pass through.
    """
    try:
        yield
    except RedisError as error:
        meant = _meaning(error)
        if meant is None:
            raise
        raise meant from error


def _meaning(error: RedisError) -> RecordsUnavailable | None:
    match error:
        case AuthenticationError():
            return RecordsRefuse(_of_a_password(str(error)))
        case NoPermissionError():
            return RecordsRefuse(
                f"Redis does not let the user of GAITWAY_REDIS_URL do this ({_last_words(error)}): give that "
                "user `~* &* +@all` (ACL SETUSER), or name another."
            )
        case OutOfMemoryError():
            return RecordsUnavailable("Redis at GAITWAY_REDIS_URL has no memory left: raise its maxmemory.")
        case ReadOnlyError() | MasterDownError():
            return RecordsUnavailable(
                "GAITWAY_REDIS_URL leads to a replica. It takes no writes: set it to its primary's address."
            )
        case BusyLoadingError():
            return RecordsUnavailable("Redis at GAITWAY_REDIS_URL is still reading its data: wait for it.")
        case InvalidResponse():
            return RecordsRefuse(
                "The server at GAITWAY_REDIS_URL is not Redis: correct its host and port, and begin it with "
                "rediss:// if that Redis wants TLS."
            )
        case ConnectionError() | TimeoutError():
            return _of_no_answer(error)
        case ResponseError():
            return _of_text(str(error))
        case _:
            return None


def _of_a_password(words: str) -> str:
    if any(known in words for known in _WANTS_A_PASSWORD):
        return (
            "GAITWAY_REDIS_URL has no password and that Redis wants one: write "
            "redis://:PASSWORD@HOST:PORT/0 or redis://USER:PASSWORD@HOST:PORT/0."
        )
    return (
        "The user or the password in GAITWAY_REDIS_URL is wrong: write those that Redis has (its requirepass "
        "or its ACL), with characters such as / # @ percent-encoded."
    )


def _of_no_answer(error: RedisError) -> RecordsUnavailable:
    without = "begin the address with redis://"
    if refusal := tls_refusal(error, "Redis", "GAITWAY_REDIS_URL", without):
        return RecordsRefuse(refusal)
    words = str(error).rstrip(".")
    if "handshake operation timed out" in reason(error):
        remedy = f"The server there does not speak TLS: {without}, if it has none"
    elif any(known in words for known in _HUNG_UP):
        remedy = "If this continues and that Redis wants TLS, begin the address with rediss://"
    else:
        remedy = "Start it, or correct the setting"
    return RecordsUnavailable(f"Redis does not answer at GAITWAY_REDIS_URL: {words}. {remedy}.")


def _of_text(words: str) -> RecordsUnavailable | None:
    for known, (kind, sentence) in _REFUSALS.items():
        if known in words:
            return kind(sentence)
    return None


def _last_words(error: RedisError) -> str:
    """Redis' message, without what a pipeline puts before it."""
    return str(error).rpartition("caused error: ")[2]
