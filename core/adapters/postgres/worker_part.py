"""The part of the record for workers."""

from collections.abc import Sequence
from datetime import timedelta

from core.adapters.cursors import check_worker_cursor
from core.adapters.postgres import workers
from core.adapters.postgres.connected import Connected
from core.jobs.workers import WorkerInfo, WorkerPage


class PostgresWorkers(Connected):
    """A WorkerStore."""

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        with self._statements() as connection:
            workers.announce(connection, worker, ttl)

    def withdraw(self, name: str) -> None:
        with self._statements() as connection:
            workers.withdraw(connection, name)

    def workers(self) -> Sequence[WorkerInfo]:
        with self._statements() as connection:
            return workers.every(connection)

    def list_workers(self, *, cursor: str | None = None, limit: int = 50) -> WorkerPage:
        after = None if cursor is None else check_worker_cursor(cursor)
        with self._statements() as connection:
            return workers.page(connection, after, limit)
