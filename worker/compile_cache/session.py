"""Brings to an attempt what was compiled before, and keeps what it compiles for later ones.

The training process knows nothing of this: it finds a folder `cache` in its working directory.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Thread

import structlog

from core.jobs.job import utc_now
from core.jobs.resolved import model_of
from core.jobs.spec import EnvironmentSpec
from core.retry import CalledOff
from core.settings import WorkerSettings
from core.storage.objects import ObjectStore
from worker.compile_cache.fingerprint import fingerprint
from worker.compile_cache.local import (
    CACHE,
    keep_within,
    lend,
    lend_copies,
    take_over,
    take_over_copies,
)
from worker.compile_cache.remote import SharedCache

log = structlog.get_logger()

# How long a job waits for what others compiled before it starts without it.
_FETCH_TIMEOUT_S = 10.0
# How long a worker waits after a job until what it compiled has been uploaded.
_STORE_TIMEOUT_S = 60.0
_POLL_S = 0.05


class Caches:
    """No failure here fails the job: it compiles, as a first one would, and the worker's log says why."""

    def __init__(
        self, objects: ObjectStore, settings: WorkerSettings, device: str, spool: Path, room: Path
    ) -> None:
        """room: a folder on the same disk that the job cannot reach, for what is not whole yet."""
        self._objects = objects
        self._machine = fingerprint(device)
        self._all = settings.data_dir.absolute() / CACHE
        self._kept, self._own, self._room = self._all / self._machine, spool / CACHE, room
        self._max_bytes, self._shared_max_bytes = settings.cache_max_bytes, settings.shared_cache_max_bytes
        self._shared: SharedCache | None = None
        self._thread: Thread | None = None  # The last that was begun; each waits for the one before.
        self._lent: set[str] | None = None  # The copies that a job with a user's model got.

    def open(self, environment: EnvironmentSpec, called_off: Callable[[], bool]) -> None:
        """Give the job what was compiled for its environment, here or elsewhere. Raises CalledOff.

        A job with a user's model gets copies, and leaves what it compiles to jobs with that model alone.
        """
        machines, model_id = self._kept, model_of(environment)
        if model_id is not None:
            self._kept = self._all / f"{self._machine}-{model_id.removeprefix('sha256:')}"
            self._kept.mkdir(parents=True, exist_ok=True)
        if self._shared_max_bytes:
            self._shared = SharedCache(self._objects, self._machine, cached_as(environment))
            self._begin("caches_not_fetched", partial(self._fetch, self._shared))
            self._wait(_FETCH_TIMEOUT_S, called_off)
        if model_id is None:
            _attempt("caches_not_lent", partial(lend, self._kept, self._own))
        else:
            self._lent = set()
            _attempt("caches_not_lent", partial(self._lend_copies, machines))

    def keep(self) -> None:
        """Keep what the job has compiled by now, and begin to upload it."""
        _attempt("caches_not_kept", self._keep)

    def close(self, called_off: Callable[[], bool]) -> None:
        """Finish the upload, within a time limit, and keep the cache within its size."""
        try:
            self._wait(_STORE_TIMEOUT_S, called_off)
        except CalledOff:
            log.info("caches_not_shared", error="The worker shuts down.")
        _attempt("caches_not_bounded", partial(keep_within, self._all, self._max_bytes))

    def _fetch(self, shared: SharedCache) -> None:
        if fetched := shared.fetch(self._kept, self._room):
            log.info("caches_fetched", num_files=fetched)

    def _lend_copies(self, machines: Path) -> None:
        self._lent = lend_copies((self._kept, machines), self._own)

    def _keep(self) -> None:
        if self._lent is None:
            new = take_over(self._own, self._kept)
        else:
            new = take_over_copies(self._own, self._kept, self._lent)
        if new and self._shared:
            self._begin("caches_not_shared", partial(self._store, self._shared, new))

    def _store(self, shared: SharedCache, new: list[str]) -> None:
        stored = shared.store(self._kept, new, utc_now())
        shared.keep_within(self._shared_max_bytes)
        log.info("caches_shared", num_files=stored)

    def _begin(self, failure: str, step: Callable[[], None]) -> None:
        before = self._thread

        def work() -> None:
            if before:
                before.join()
            _attempt(failure, step)

        self._thread = Thread(target=work, name="caches", daemon=True)
        self._thread.start()

    def _wait(self, timeout_s: float, called_off: Callable[[], bool]) -> None:
        until = time.monotonic() + timeout_s
        while self._thread and self._thread.is_alive() and time.monotonic() < until:
            if called_off():
                raise CalledOff
            self._thread.join(_POLL_S)


def cached_as(environment: EnvironmentSpec) -> str:
    """The cache's name, without slashes; each model of a user has its own, since no other can use it."""
    model_id, environment_id = model_of(environment) or "", environment.id.replace("/", "-")
    return "-".join(filter(None, (environment_id, model_id.removeprefix("sha256:")[:16])))


def _attempt(failure: str, step: Callable[[], None]) -> None:
    try:
        step()
    except Exception as error:  # Whatever it is, no job must fail for it.
        log.warning(failure, error=str(error))
