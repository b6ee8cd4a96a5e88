"""A PostgreSQL that tests stop, silence and start again; a reconciler; and a worker without work."""

import signal
import threading
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

import psutil
import psycopg
import pytest
from rq import SimpleWorker
from rq.serializers import JSONSerializer

from core.adapters.postgres import schema
from core.adapters.postgres.engine import connect_postgres
from core.adapters.postgres.store import PostgresJobStore
from core.errors import Unavailable
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.job import Job
from core.jobs.queue import JobQueue, queue_names
from core.jobs.reconciliation import Reconciler
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.jobs.submission import Acknowledgements, submit
from core.reasons import Reason
from core.storage.objects import ObjectStore
from gaitway.service.embedded.postgres import Postgres


class Outages:
    """A running PostgreSQL with a template that has the tables, and what is done to it."""

    def __init__(self, server: Postgres) -> None:
        self._server = server
        self._num_made = 0
        schema.upgrade(connect_postgres(server.url, pool_size=0))

    def fresh(self) -> str:
        """The address of a new database with empty tables."""
        self._num_made += 1
        name = f"test_{self._num_made}"
        with psycopg.connect(
            self._server.admin_url.replace("/gaitway?", "/postgres?"), autocommit=True
        ) as admin:
            admin.execute(f"CREATE DATABASE {name} TEMPLATE gaitway".encode())
        return self._server.admin_url.replace("/gaitway?", f"/{name}?")

    @contextmanager
    def silence(self) -> Generator[None]:
        """Within this it takes connections and says nothing: every process of it is stopped."""
        server = psutil.Process(self._server.process.pid)
        server.suspend()  # First the one that would start others.
        children = server.children(recursive=True)
        for process in children:
            with suppress(psutil.NoSuchProcess):  # Its client has just gone.
                process.suspend()
        try:
            yield
        finally:
            for process in (server, *children):
                with suppress(psutil.NoSuchProcess):
                    process.resume()

    @contextmanager
    def absence(self) -> Generator[None]:
        """Within this nobody answers."""
        self._server.stop()
        try:
            yield
        finally:
            self._server.start()

    @contextmanager
    def crash(self) -> Generator[None]:
        """Within this nothing writes the log but a commit that waits for it; then every process is killed.

        Returns when it has started again.
        """
        server = psutil.Process(self._server.process.pid)
        for process in server.children():
            if any(name in " ".join(process.cmdline()) for name in _WRITERS):
                process.suspend()
        try:
            yield
        finally:
            for process in (server, *server.children()):
                with suppress(psutil.NoSuchProcess):  # One whose server has gone ends by itself.
                    process.kill()
            self._server.stop()
            self._server.start()


# As PostgreSQL names its processes that write on their own account.
_WRITERS = ("walwriter", "checkpointer", "background writer", "autovacuum")


class NullWorker:
    """Takes what RQ has, as a worker does; each attempt that it can claim succeeds at once.

    claimed: how often it claimed which job.
    """

    def __init__(self, store: JobStore, objects: ObjectStore, redis: Any) -> None:
        self.claimed = Counter[str]()
        self._store, self._objects, self._redis = store, objects, redis

    def work(self, most: int | None = None) -> None:
        """Until nothing waits, or it has done so many."""
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        names = list(queue_names("cpu"))
        worker = SimpleWorker(names, connection=self._redis, serializer=JSONSerializer)  # type: ignore[arg-type]
        try:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("worker.tasks.run_attempt", self._attempt)
                worker.work(burst=True, max_jobs=most, logging_level="WARNING")
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)

    def _attempt(self, job_id: str, attempt: int) -> None:
        claim = claim_attempt(
            job_id,
            attempt,
            "null",
            store=self._store,
            objects=self._objects,
            lease=timedelta(seconds=15),
            secret=new_secret(),
        )
        if claim is not None:
            self.claimed[job_id] += 1
            claim.start()
            claim.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Everything asked for is done.")


class Watch:
    """A reconciler in a thread of its own. num_looks: how often it found out all that it wanted."""

    def __init__(self, store: JobStore, queue: JobQueue, lease: timedelta, every_s: float = 0.2) -> None:
        self.num_looks = 0
        self._reconciler = Reconciler(store, queue, lease)
        self._every_s = every_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watch")

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(self._every_s):
            try:
                self._reconciler.run_once()
            except Unavailable:
                continue
            self.num_looks += 1


def submitted(store: JobStore, queue: JobQueue, **fields: Any) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **fields})
    heard = Acknowledgements(store.dispatched)
    return submit(spec, store=store, queue=queue, acknowledge=heard.add_at_once)


def pooled(url: str, pool_size: int = 2) -> PostgresJobStore:
    """A store with connections of its own, as another process has it."""
    return PostgresJobStore(connect_postgres(url, pool_size=pool_size))
