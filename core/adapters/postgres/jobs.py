"""The record in PostgreSQL."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import datetime, timedelta

from psycopg.errors import UniqueViolation
from sqlalchemy import Engine, select
from sqlalchemy.exc import DataError, IntegrityError

from core.adapters.cursors import check_cursor
from core.adapters.postgres import (
    copies,
    deletions,
    dispatch,
    feeds,
    leases,
    listing,
    loading,
    models,
    pages,
    references,
    saving,
    submissions,
    workers,
)
from core.adapters.postgres.clock import Clock
from core.adapters.postgres.model_part import PostgresModels
from core.adapters.postgres.sweep_part import PostgresSweeps
from core.adapters.postgres.tables import NOW, pulse
from core.adapters.postgres.worker_part import PostgresWorkers
from core.errors import JobExists, JobNotFound, JobUnreadable, LeaseLost
from core.jobs.job import Job, Progress, UnreadableJob, check_job_id
from core.jobs.queue import MOST_WAITING, all_queues
from core.jobs.status import JobStatus
from core.jobs.store import (
    Channel,
    Chunk,
    Dispatch,
    Entry,
    FeedPart,
    Idempotency,
    JobQuery,
    Mark,
    MeasuredPart,
    Page,
)

# Built once: it is a part of every claim.
_SELECT_NOW = select(NOW)


class PostgresJobStore(PostgresModels, PostgresSweeps, PostgresWorkers):
    """A SweepStore, and so a JobStore, for many processes; thread-safe.

    Each method is one transaction, or a few statements that are one each; the statements are in the modules
    beside this one. clock_age: how long `now` extrapolates from the database's last answer.
    """

    def __init__(self, engine: Engine, *, clock_age: timedelta = timedelta(seconds=1)) -> None:
        super().__init__(engine)
        self._clock = Clock(self._time, clock_age)

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()

    def now(self) -> datetime:
        return self._clock.now()

    # ---- jobs ------------------------------------------------------------------------------------

    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        try:
            # A job that was never tried is one statement.
            source = job.spec.source if job.status == JobStatus.QUEUED else None
            is_more = bool(job.attempts or job.artifacts or source)
            with self._transaction() if is_more else self._statements() as connection:
                if source is not None:
                    deletions.hold_source(connection, source.job)
                if submissions.add(connection, job, idempotency):
                    return job
        except IntegrityError:
            raise JobExists(job.id) from None
        assert idempotency is not None  # noqa: S101
        # None if the earlier job was deleted, and its key with it, between the two statements.
        return self.remembered(idempotency) or self.add(job, idempotency)

    def import_job(
        self,
        job: Job,
        events: Iterable[Entry],
        logs: Iterable[Entry],
        *,
        idempotency: Idempotency | None = None,
    ) -> bool:
        try:
            with (
                feeds.prepared(events) as said,
                feeds.prepared(logs) as printed,
                self._transaction(is_large=True) as connection,
            ):
                if not submissions.add(connection, job, idempotency):
                    return False
                feeds.append_all(connection, job.id, "events", said)
                feeds.append_all(connection, job.id, "logs", printed)
        except IntegrityError as error:
            if isinstance(error.orig, UniqueViolation):
                return False
            raise
        except DataError as error:  # Such as the character U+0000 in a message.
            raise JobUnreadable(job.id, str(error.orig)) from error
        return True

    def remembered(self, idempotency: Idempotency) -> Job | None:
        with self._statements() as connection:
            job_id = submissions.remembered(connection, idempotency)
            return None if job_id is None else loading.readable(loading.find(connection, job_id))

    def find(self, job_id: str) -> Job | UnreadableJob:
        with self._statements() as connection:
            return loading.find(connection, check_job_id(job_id))

    def get(self, job_id: str) -> Job:
        return loading.readable(self.find(job_id))

    def save(self, job: Job, *, lease: timedelta | None = None) -> None:
        with self._transaction() as connection:
            saving.save(connection, job, lease=lease)

    def take_back(self, job: Job) -> None:
        with self._transaction() as connection:
            saving.save(connection, job, leases.is_over())

    def delete(self, job_id: str, version: int) -> None:
        with self._transaction() as connection:
            deletions.begin(connection, job_id, version)

    def deletions(self, *, before: timedelta = timedelta(0)) -> Sequence[str]:
        with self._statements() as connection:
            return deletions.begun(connection, before)

    def deletion_ended(self, job_id: str) -> None:
        with self._statements() as connection:
            deletions.ended(connection, job_id)

    def list(
        self, query: JobQuery, *, cursor: str | None = None, limit: int = 50, brief: bool = False
    ) -> Page:
        before = None if cursor is None else check_cursor(cursor)
        with self._statements() as connection:
            rows = listing.newest(connection, query, before, limit + 1)
            found = loading.of_rows(connection, rows[:limit], brief=brief)
        return Page(found, found[-1].id if pages.has_more(rows, len(found)) else None)

    def marks(self, job_ids: Collection[str]) -> Mapping[str, Mark]:
        with self._statements() as connection:
            return loading.marks(connection, job_ids)

    def users_of(self, model_id: str) -> Sequence[str]:
        with self._statements() as connection:
            return references.users_of(connection, model_id)

    def borrowers_of(self, job_id: str) -> Sequence[tuple[str, int | None]]:
        with self._statements() as connection:
            return references.borrowers_of(connection, job_id)

    def objects_named(self, job_ids: Collection[str]) -> Collection[str]:
        with self._statements() as connection:
            return references.objects_named(connection, job_ids)

    # ---- copies in the object store --------------------------------------------------------------

    def uncopied(self, *, limit: int) -> Sequence[Job | UnreadableJob]:
        with self._statements() as connection:
            return copies.uncopied(connection, limit)

    def copied(self, job_id: str, version: int) -> bool:
        with self._statements() as connection:
            return copies.copied(connection, job_id, version)

    def restore(self, job: Job, *, replaces: int | None, note: str, chunks: Sequence[Chunk] = ()) -> None:
        try:
            with self._transaction() as connection:
                copies.restore(connection, job, replaces, note, chunks)
        except IntegrityError:
            raise JobExists(job.id) from None

    # ---- leases ----------------------------------------------------------------------------------

    def renew(self, job_id: str, token: str, lease: timedelta) -> JobStatus:
        with self._statements() as connection:
            return leases.renew(connection, job_id, token, lease)

    def expired(self) -> Iterable[Job]:
        with self._statements() as connection:
            return leases.expired(connection)

    def beat(self, lease: timedelta) -> None:
        with self._transaction() as connection:
            leases.beat(connection, lease)

    # ---- dispatches ------------------------------------------------------------------------------

    def waiting(
        self, room: Mapping[str, int] | None = None, but_not: Collection[tuple[str, int]] = ()
    ) -> Sequence[Dispatch]:
        room = dict.fromkeys(all_queues(), MOST_WAITING) if room is None else room
        with self._statements() as connection:
            return [*dispatch.waiting(connection, room, but_not), *models.waiting(connection)]

    def undispatched(self) -> Sequence[Dispatch]:
        with self._statements() as connection:
            return dispatch.undispatched(connection)

    def dispatched(self, dispatches: Sequence[Dispatch]) -> None:
        if dispatches:
            with self._statements() as connection:
                dispatch.remove(connection, dispatches)

    # ---- feeds -----------------------------------------------------------------------------------

    def record(
        self,
        job_id: str,
        token: str,
        channel: Channel,
        entries: Sequence[Entry],
        progress: Progress | None = None,
        *,
        write_id: str,
    ) -> None:
        with self._statements() as connection:
            if not feeds.append_as_attempt(connection, job_id, token, channel, entries, progress, write_id):
                raise LeaseLost(job_id)

    def feed(self, job_id: str, channel: Channel, *, after: int = 0, limit: int = 1000) -> FeedPart:
        with self._statements() as connection:
            found = feeds.read(connection, job_id, channel, after, limit)
        if found is None:
            raise JobNotFound(job_id[:64])
        return found

    def feed_metrics(self, job_id: str, *, after: int, limit: int) -> MeasuredPart:
        with self._statements() as connection:
            found = feeds.read_metrics(connection, job_id, after, limit)
        if found is None:
            raise JobNotFound(job_id[:64])
        return found

    def long_feeds(self, *, max_bytes: int, max_age: timedelta) -> Sequence[tuple[str, Channel]]:
        with self._transaction() as connection:
            return feeds.due(connection, max_bytes, max_age)

    def oldest_entries(
        self, job_id: str, channel: Channel, *, limit: int, max_bytes: int = 2**40
    ) -> Sequence[Entry]:
        with self._statements() as connection:
            return feeds.oldest(connection, job_id, channel, limit, max_bytes)

    def replace_by_chunk(self, job_id: str, chunk: Chunk) -> None:
        with self._transaction() as connection:
            feeds.replace_by_chunk(connection, job_id, chunk)

    def chunks(self, job_ids: Collection[str]) -> Mapping[str, Sequence[Chunk]]:
        with self._statements() as connection:
            return feeds.chunks_of(connection, job_ids)

    def replace_chunk(self, job_id: str, lost: Chunk, found: Chunk) -> None:
        with self._transaction() as connection:
            feeds.replace_chunk(connection, job_id, lost, found)

    # ---- upkeep ----------------------------------------------------------------------------------

    def tidy(self) -> None:
        with self._transaction() as connection:
            submissions.forget_old_keys(connection)
            workers.forget_gone(connection)

    def ping(self) -> None:
        with self._statements() as connection:
            connection.execute(select(pulse.c.id))

    # ---- inside ----------------------------------------------------------------------------------

    def _time(self) -> datetime:
        with self._statements() as connection:
            return connection.execute(_SELECT_NOW).scalar_one()
