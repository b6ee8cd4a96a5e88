"""The seam to the live records: jobs, their feeds, their leases, and the workers."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal, Protocol

from pydantic import Field

from core.jobs.job import Job, Progress
from core.jobs.status import JobStatus
from core.model import Stored

Channel = Literal["events", "logs"]


class Entry(Stored):
    """Something that happened to a job, in the order it happened.

    kind: `status`, `progress`, `metrics`, `artifact`, `phase`, `note` in `events`; `line` in `logs`.
    id is given by the store, rises strictly within a channel, and is text without spaces.
    """

    id: str = ""
    kind: str
    time: datetime
    data: dict[str, Any] = {}


class WorkerInfo(Stored):
    """What a worker says of itself at every heartbeat."""

    name: str
    host: str
    pid: int
    device: str
    queues: tuple[str, ...] = ()
    job: str | None = None
    started_at: datetime
    seen_at: datetime


class JobQuery(Stored):
    """Which jobs a listing is about; None means any. labels: every one must match."""

    status: JobStatus | None = None
    kind: str | None = None
    environment: str | None = None
    name: str | None = None
    labels: dict[str, str] = Field(default_factory=dict)

    def matches(self, job: Job) -> bool:
        return (
            self.status in (None, job.status)
            and self.kind in (None, job.spec.kind)
            and self.environment in (None, job.spec.environment.id)
            and self.name in (None, job.spec.name)
            and self.labels.items() <= job.spec.labels.items()
        )


@dataclass(frozen=True)
class Idempotency:
    """A client's key for a submission, and a fingerprint of the body it came with."""

    key: str
    fingerprint: str


@dataclass(frozen=True)
class Page:
    """Some jobs, newest first, and where to go on; None at the end."""

    jobs: Sequence[Job]
    next_cursor: str | None


class JobStore(Protocol):
    """Live state. Every method raises RecordsUnavailable when the store cannot be reached.

    Writes are atomic. `save` is a compare-and-set on the version; `renew` and `record` carry an
    attempt's token and change nothing when another attempt (or none) holds the job.
    """

    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        """Store a new job and return it; or, for a key seen before with the same fingerprint, the job stored
        then. Raises IdempotencyKeyReused for another fingerprint, JobExists for an id already there.
        Keys are remembered for 24 hours."""
        ...

    def remembered(self, idempotency: Idempotency) -> Job | None:
        """The job an earlier submission with this key made. Raises IdempotencyKeyReused."""
        ...

    def get(self, job_id: str) -> Job:
        """With its latest progress. Raises JobNotFound."""
        ...

    def save(self, job: Job, *, lease: timedelta | None = None) -> None:
        """Store the next version; with `lease`, also start the present attempt's lease.

        Raises StaleJob unless the stored version is the one before, JobNotFound where there is none.
        The progress in `job` is not stored: `record` does that. A change of status appends a `status`
        entry ({"status", "reason", "message", "attempt"}) to the events. A job that no attempt holds has
        no lease.
        """
        ...

    def delete(self, job: Job) -> None:
        """Forget the job, its feeds and its lease. Raises StaleJob where its version has moved on."""
        ...

    def list(self, query: JobQuery, *, cursor: str | None = None, limit: int = 50) -> Page:
        """Newest first. cursor: the `next_cursor` of an earlier page."""
        ...

    def unfinished(self) -> Iterable[Job]:
        """Every job without a final status, oldest first."""
        ...

    def renew(self, job_id: str, token: str, lease: timedelta) -> JobStatus:
        """Prolong the lease of the attempt that holds the job; its present status. Raises LeaseLost."""
        ...

    def lease_is_alive(self, job_id: str) -> bool: ...

    def record(
        self,
        job_id: str,
        token: str,
        channel: Channel,
        entries: Sequence[Entry],
        progress: Progress | None = None,
    ) -> None:
        """Append to a feed, and replace the progress where given; all or nothing. Raises LeaseLost."""
        ...

    def feed(
        self, job_id: str, channel: Channel, *, after: str = "", kind: str | None = None, limit: int = 1000
    ) -> Sequence[Entry]:
        """Entries later than the id `after`, oldest first; empty when there are none. Raises JobNotFound.
        `kind` filters; `limit` bounds what is returned."""
        ...

    def wait(self, job_id: str, channel: Channel, *, after: str = "", timeout: timedelta) -> bool:
        """Block until the feed has an entry later than `after`, at most this long; whether it has."""
        ...

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None: ...

    def withdraw(self, name: str) -> None:
        """A worker has gone."""
        ...

    def workers(self) -> Sequence[WorkerInfo]: ...

    def ping(self) -> None:
        """Raises RecordsUnavailable."""
        ...
