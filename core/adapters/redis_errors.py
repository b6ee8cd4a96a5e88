"""Which of Redis' errors mean that the records cannot be reached now."""

from collections.abc import Generator
from contextlib import contextmanager

from redis.exceptions import (
    ConnectionError,
    MasterDownError,
    NoPermissionError,
    OutOfMemoryError,
    ReadOnlyError,
    ResponseError,
    TimeoutError,
)

from core.errors import RecordsUnavailable

_UNREACHABLE = (
    ConnectionError,
    MasterDownError,
    NoPermissionError,
    OutOfMemoryError,
    ReadOnlyError,
    TimeoutError,
)
# Refusals that the client knows only by their text.
_REFUSALS = ("MISCONF", "NOREPLICAS", "CLUSTERDOWN", "BUSY ", "OOM", "READONLY", "LOADING", "NOPERM")


@contextmanager
def reaching_redis() -> Generator[None]:
    """Turn outages and refusals into RecordsUnavailable; also a decorator. Our own mistakes pass through."""
    try:
        yield
    except _UNREACHABLE as error:
        raise RecordsUnavailable(f"Redis cannot be reached at GAITWAY_REDIS_URL: {error}") from error
    except ResponseError as error:
        if not str(error).startswith(_REFUSALS):
            raise
        raise RecordsUnavailable(f"Redis at GAITWAY_REDIS_URL refuses: {error}") from error
