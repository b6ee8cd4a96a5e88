"""Times calls to the stores, for monitoring."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Literal, Protocol

from core.errors import Unavailable

StoreName = Literal["postgresql", "redis", "objects"]


class Observe(Protocol):
    """Called after each call to a store. failed: the store was unavailable."""

    def __call__(self, store: StoreName, seconds: float, *, failed: bool) -> None: ...


def unobserved(store: StoreName, seconds: float, *, failed: bool) -> None:
    """For processes that nobody monitors."""


@contextmanager
def timed(observe: Observe, store: StoreName) -> Generator[None]:
    """Times the block; an exception of another kind than Unavailable is an answer, too."""
    began = time.perf_counter()
    try:
        yield
    except Unavailable:
        observe(store, time.perf_counter() - began, failed=True)
        raise
    except BaseException:
        observe(store, time.perf_counter() - began, failed=False)
        raise
    observe(store, time.perf_counter() - began, failed=False)
