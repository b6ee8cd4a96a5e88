"""Values for the end of a training, made in a thread while a GPU trains and the processor is idle."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import Generic, TypeVar, cast

T = TypeVar("T")


class Prepared(Generic[T]):
    """A value that is made once: from `begin` on, or at the latest where it is asked for."""

    def __init__(self, make: Callable[[], T]) -> None:
        self._make = make
        self._future: Future[T] | None = None

    def begin(self) -> None:
        """Make it in a thread, one value after the other: two would only wait for Python's lock."""
        if self._future is None:
            self._future = _thread().submit(self._make)

    def value(self) -> T:
        """Raises as the function that makes it."""
        self.begin()
        return cast("Future[T]", self._future).result()


@cache
def _thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "prepares")
