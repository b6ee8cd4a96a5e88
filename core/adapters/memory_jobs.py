"""Job records in this process' memory: the twin that tests hold the real store to."""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import timedelta
from threading import Condition, RLock

from core.adapters.cursors import check_cursor, entry_position
from core.adapters.entries import status_entry
from core.errors import IdempotencyKeyReused, JobExists, JobNotFound, LeaseLost, StaleJob
from core.jobs.job import Job, Progress
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry, Idempotency, JobQuery, Page, WorkerInfo

REMEMBERED = timedelta(hours=24)


@dataclass
class _Record:
    job: Job
    feeds: dict[Channel, list[Entry]] = field(default_factory=lambda: {"events": [], "logs": []})
    lease_token: str = ""
    lease_until: float = 0.0


class MemoryJobStore:
    """A JobStore for one process; thread-safe. clock: seconds that never go back."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._records: dict[str, _Record] = {}
        self._remembered: dict[str, tuple[str, str, float]] = {}
        self._workers: dict[str, tuple[WorkerInfo, float]] = {}
        self._num_entries = 0
        self._changed = Condition(RLock())

    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        with self._changed:
            if idempotency is not None and (earlier := self.remembered(idempotency)) is not None:
                return earlier
            if job.id in self._records:
                raise JobExists(job.id)
            self._records[job.id] = _Record(job)
            if idempotency is not None:
                until = self._clock() + REMEMBERED.total_seconds()
                self._remembered[idempotency.key] = (idempotency.fingerprint, job.id, until)
            return job

    def remembered(self, idempotency: Idempotency) -> Job | None:
        with self._changed:
            fingerprint, job_id, until = self._remembered.get(idempotency.key, ("", "", 0.0))
            if until <= self._clock() or job_id not in self._records:
                return None
            if fingerprint != idempotency.fingerprint:
                raise IdempotencyKeyReused(idempotency.key)
            return self._records[job_id].job

    def get(self, job_id: str) -> Job:
        with self._changed:
            return self._record(job_id).job

    def save(self, job: Job, *, lease: timedelta | None = None) -> None:
        with self._changed:
            record = self._record(job.id)
            if record.job.version != job.version - 1:
                raise StaleJob(job.id)
            if record.job.status != job.status:
                self._append(record, "events", [status_entry(job)])
            record.job = job.model_copy(update={"progress": record.job.progress})
            if lease is not None and job.token:
                self._lease(record, lease)
            elif record.lease_token != job.token:
                record.lease_token = ""

    def delete(self, job: Job) -> None:
        with self._changed:
            if self._record(job.id).job.version != job.version:
                raise StaleJob(job.id)
            del self._records[job.id]

    def list(self, query: JobQuery, *, cursor: str | None = None, limit: int = 50) -> Page:
        before = None if cursor is None else check_cursor(cursor)
        with self._changed:
            ids = sorted((i for i in self._records if before is None or i < before), reverse=True)
            jobs = [job for i in ids if query.matches(job := self._records[i].job)]
        return Page(jobs[:limit], jobs[limit - 1].id if len(jobs) > limit else None)

    def unfinished(self) -> Iterable[Job]:
        with self._changed:
            jobs = [self._records[i].job for i in sorted(self._records)]
        return [job for job in jobs if not job.status.is_final]

    def renew(self, job_id: str, token: str, lease: timedelta) -> JobStatus:
        with self._changed:
            record = self._held(job_id, token)
            self._lease(record, lease)
            return record.job.status

    def lease_is_alive(self, job_id: str) -> bool:
        with self._changed:
            record = self._records.get(job_id)
            return record is not None and record.lease_token != "" and self._clock() < record.lease_until

    def record(
        self,
        job_id: str,
        token: str,
        channel: Channel,
        entries: Sequence[Entry],
        progress: Progress | None = None,
    ) -> None:
        with self._changed:
            record = self._held(job_id, token)
            self._append(record, channel, entries)
            if progress is not None:
                record.job = record.job.model_copy(update={"progress": progress})

    def feed(
        self, job_id: str, channel: Channel, *, after: str = "", kind: str | None = None, limit: int = 1000
    ) -> Sequence[Entry]:
        start = entry_position(after)
        with self._changed:
            entries = self._record(job_id).feeds[channel]
            return [e for e in entries if entry_position(e.id) > start and kind in (None, e.kind)][:limit]

    def wait(self, job_id: str, channel: Channel, *, after: str = "", timeout: timedelta) -> bool:
        start = entry_position(after)

        def has_more() -> bool:
            record = self._records.get(job_id)
            return record is not None and any(
                entry_position(e.id) > start for e in record.feeds[channel][-1:]
            )

        with self._changed:
            return self._changed.wait_for(has_more, timeout.total_seconds())

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        with self._changed:
            self._workers[worker.name] = (worker, self._clock() + ttl.total_seconds())

    def withdraw(self, name: str) -> None:
        with self._changed, suppress(KeyError):
            del self._workers[name]

    def workers(self) -> Sequence[WorkerInfo]:
        with self._changed:
            now = self._clock()
            return [worker for _, (worker, until) in sorted(self._workers.items()) if now < until]

    def ping(self) -> None:
        return None

    def _record(self, job_id: str) -> _Record:
        try:
            return self._records[job_id]
        except KeyError:
            raise JobNotFound(job_id[:64]) from None

    def _held(self, job_id: str, token: str) -> _Record:
        record = self._records.get(job_id)
        if record is None or not token or record.job.token != token:
            raise LeaseLost(job_id)
        return record

    def _lease(self, record: _Record, lease: timedelta) -> None:
        record.lease_token = record.job.token
        record.lease_until = self._clock() + lease.total_seconds()

    def _append(self, record: _Record, channel: Channel, entries: Sequence[Entry]) -> None:
        for entry in entries:
            self._num_entries += 1
            record.feeds[channel].append(entry.model_copy(update={"id": f"{self._num_entries}-0"}))
        self._changed.notify_all()
