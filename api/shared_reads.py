"""Readings of the record that several readers share.

Those who wait for the same answer get one reading, clients that say so get an answer of the last moments, and
for all live streams one query finds the jobs that changed.
"""

import asyncio
import re
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Coroutine, Generator, Hashable, Mapping, Sequence
from contextlib import contextmanager
from contextvars import Context
from datetime import timedelta
from threading import Lock
from typing import Any, Generic, TypeVar

import anyio
import structlog
from anyio import CapacityLimiter, to_thread

from core.accounts.principal import Ownership
from core.errors import Unavailable
from core.jobs.forecast import forecasts_of
from core.jobs.store import JobStore, Mark
from core.jobs.workers import WorkerInfo
from gaitway.schema import TurnView

Answer = TypeVar("Answer")
_MAX_AGE = re.compile(r"\bmax-age=(\d{1,3})\b")
_MAX_ANSWERS = 64
log = structlog.get_logger()
_PAUSE_S = 0.1
_TURNS_FOR_S = 1.0
_PAUSE_IN_OUTAGE_S = 1.0


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


def max_age_s(cache_control: str) -> float:
    """The age that the header `Cache-Control` of a request allows; 0 if it says nothing."""
    found = _MAX_AGE.search(cache_control)
    return float(found[1]) if found else 0.0


class RecentAnswers:
    """The newest answer to each of the questions that were asked last."""

    def __init__(self) -> None:
        self._answers = OrderedDict[str, tuple[float, bytes]]()
        self._lock = Lock()

    def find(self, question: str, max_age_s: float) -> bytes | None:
        """An answer of at most this age, or None."""
        with self._lock:
            since, answer = self._answers.get(question, (0.0, b""))
        return answer if answer and time.monotonic() - since <= max_age_s else None

    def keep(self, question: str, answer: bytes) -> None:
        with self._lock:
            self._answers[question] = (time.monotonic(), answer)
            self._answers.move_to_end(question)
            if len(self._answers) > _MAX_ANSWERS:
                self._answers.popitem(last=False)


class Turns:
    """When the waiting jobs should start, as it was found out in the last moments; thread-safe."""

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._lock = Lock()
        self._found: Mapping[str, TurnView] = {}
        self._until = 0.0

    def now(self, workers: Sequence[WorkerInfo]) -> Mapping[str, TurnView]:
        """By job. Where ten thousand wait it takes a tenth of a second, so it is not done at each request."""
        # Only the first readers of all wait for one who finds it out; later ones get what was known before.
        if time.monotonic() >= self._until and self._lock.acquire(blocking=self._until == 0.0):
            try:
                if time.monotonic() >= self._until:
                    self._look(workers)
            finally:
                self._lock.release()
        return self._found

    def _look(self, workers: Sequence[WorkerInfo]) -> None:
        """Read it again; in an outage keep what was known, and do not try again at once."""
        began = time.monotonic()
        try:
            self._found = self._forecast(workers)
        except Unavailable as error:
            log.warning("turns_wait", error=error.detail)
            self._until = time.monotonic() + _PAUSE_IN_OUTAGE_S
        else:
            self._until = time.monotonic() + max(_TURNS_FOR_S, 20 * (time.monotonic() - began))

    def _forecast(self, workers: Sequence[WorkerInfo]) -> Mapping[str, TurnView]:
        now = self._store.now()
        found = forecasts_of(self._store.turn_facts(), workers, self._store.rooms())
        return {
            job: TurnView(
                before=one.before,
                reason=one.reason,
                starts_at=None if one.starts_s is None else now + timedelta(seconds=one.starts_s),
            )
            for job, one in found.items()
        }


class Owners:
    """Whose jobs and sweeps are, which never changes: the ones that were asked for last; thread-safe."""

    _MOST = 10_000

    def __init__(self) -> None:
        self._known = OrderedDict[str, Ownership]()
        self._lock = Lock()

    def known(self, name: str) -> Ownership | None:
        with self._lock:
            return self._known.get(name)

    def of(self, name: str, find: Callable[[str], Ownership]) -> Ownership:
        """The answer of `find`, or the one that it gave before. Raises as `find` does."""
        if (ownership := self.known(name)) is None:
            ownership = find(name)
            with self._lock:
                self._known[name] = ownership
                if len(self._known) > self._MOST:
                    self._known.popitem(last=False)
        return ownership


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
