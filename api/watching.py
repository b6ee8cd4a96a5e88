"""Tells the readers of live streams when their jobs change; one query covers all jobs."""

import asyncio
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from contextvars import Context

import anyio
import structlog
from anyio import CapacityLimiter, to_thread

from core.errors import Unavailable
from core.jobs.store import JobStore, Mark

log = structlog.get_logger()

_PAUSE_S = 0.1
_PAUSE_IN_OUTAGE_S = 1.0


class Watch:
    """Lets one reader of a job's stream wait until the job changes."""

    def __init__(self, watcher: "JobWatcher") -> None:
        self._watcher = watcher
        self._news = anyio.Event()

    def wake(self) -> None:
        self._news.set()

    async def news(self, timeout_s: float) -> bool:
        """Whether the job may have changed since the last call; waits up to `timeout_s` for that.

        Always true once the watcher has failed: the reader then has to query the record itself.
        """
        with anyio.move_on_after(timeout_s):
            await self._news.wait()
        if self._news.is_set():
            self._news = anyio.Event()
            return True
        return not self._watcher.is_looking


class JobWatcher:
    """Queries the record ten times a second for changes of the watched jobs, while there are any.

    All readers share that query. The watcher belongs to one event loop.
    """

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._watches: dict[str, set[Watch]] = {}
        self._marks: dict[str, Mark | None] = {}
        self._task: asyncio.Task[None] | None = None
        # A thread of its own: readers may occupy all threads of the common pool.
        self._thread = CapacityLimiter(1)

    @property
    def is_looking(self) -> bool:
        return self._task is not None and not self._task.done()

    def mark(self, job_id: str) -> Mark | None:
        """That of a watched job at the last query; None before the first, and of a job that is deleted."""
        return self._marks.get(job_id)

    @contextmanager
    def watch(self, job_id: str) -> Generator[Watch]:
        """Watch the job within this context. Read its feed once at the start, and after each change."""
        watch = Watch(self)
        self._watches.setdefault(job_id, set()).add(watch)
        if not self.is_looking:
            # An empty context: otherwise its log lines would carry the first reader's request.
            self._task = asyncio.create_task(self._look_on(), name="job watcher", context=Context())
        try:
            yield watch
        finally:
            self._watches[job_id].discard(watch)
            if not self._watches[job_id]:
                del self._watches[job_id]
                self._marks.pop(job_id, None)

    async def _look_on(self) -> None:
        is_away = False
        while self._watches:
            followed = list(self._watches)
            try:
                found = await to_thread.run_sync(self._store.marks, followed, limiter=self._thread)
            except Unavailable as error:
                if not is_away:
                    log.warning("watching_waits", error=error.detail)
                is_away = True
            else:
                is_away = False
                self._wake(followed, found)
            await anyio.sleep(_PAUSE_IN_OUTAGE_S if is_away else _PAUSE_S)

    def _wake(self, followed: list[str], found: Mapping[str, Mark]) -> None:
        """Wake the readers of each job whose mark is new or has changed since the last query."""
        for job_id in followed:
            mark = found.get(job_id)
            is_news = job_id not in self._marks or self._marks[job_id] != mark
            # The last reader may have gone during the query.
            if is_news and job_id in self._watches:
                self._marks[job_id] = mark
                for watch in self._watches[job_id]:
                    watch.wake()
