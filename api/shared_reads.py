"""Readers who wait for the same answer share one reading of the record."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Hashable
from contextvars import Context
from typing import Any, Generic, TypeVar

Answer = TypeVar("Answer")


class SharedReads(Generic[Answer]):
    """Belongs to one event loop. A reader who leaves takes the answer from nobody."""

    def __init__(self) -> None:
        self._reading: dict[Hashable, asyncio.Task[Answer]] = {}

    def read(
        self, question: Hashable, answer: Callable[[], Coroutine[Any, Any, Answer]]
    ) -> Awaitable[Answer]:
        """The answer, or what it raises; of a reading of the same question that is under way, if one is."""
        task = self._reading.get(question)
        if task is None:
            # An empty context: otherwise its log lines would carry the first reader's request.
            task = asyncio.create_task(answer(), context=Context())
            self._reading[question] = task
            task.add_done_callback(lambda task: self._forget(question, task))
        return asyncio.shield(task)

    def _forget(self, question: Hashable, task: asyncio.Task[Answer]) -> None:
        del self._reading[question]
        if not task.cancelled():
            task.exception()  # Where all its readers have left, nobody else asks for it.
