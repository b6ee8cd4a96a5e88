"""The interface of the record: jobs, their feeds, leases and dispatches."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Literal, Protocol

import msgspec
from pydantic import Field

from core.accounts.principal import Ownership
from core.documents import Stored
from core.errors import Problem, Rejected
from core.jobs.job import Job, Progress, UnreadableJob, utc_now
from core.jobs.metrics import Block, Measurement
from core.jobs.patch import JobPatch
from core.jobs.pools import Offer
from core.jobs.quotas import QuotaStore
from core.jobs.retention import RetentionStore
from core.jobs.slots import QueueCount
from core.jobs.sorting import Sort
from core.jobs.spec import JobKind
from core.jobs.status import JobStatus
from core.jobs.turns import TurnFacts
from core.jobs.uploads import Uploads
from core.jobs.usage import UsageStore
from core.jobs.workers import WorkerStore
from core.news.store import NewsStore
from core.uploads.record import KindName

# Metrics are a feed of their own, with numbers among those of the events, which are read with them.
Channel = Literal["events", "logs", "metrics"]
_LONGEST_ID = 18
ENTRY_ID = f"[0-9]{{0,{_LONGEST_ID}}}"


class Entry(msgspec.Struct, frozen=True):
    """One event of a job, or one line of its log; a feed has its entries in the order in which they happened.

    kind: `status`, `progress`, `metrics`, `artifact`, `phase`, `note` in `events`; `line` in `logs`.
    The store gives the id: 1, 2, 3, … within a channel, as text. One of the kind `metrics` says `step` and
    `values`, and comes back with values that are floats, or None where one was not finite.
    """

    kind: str
    time: datetime
    data: dict[str, Any] = msgspec.field(default_factory=dict[str, Any])
    id: str = ""


def status_entry(job: Job, time: datetime | None = None) -> Entry:
    """The event for a job's change of status; by default it has just changed."""
    attempt = job.attempts[-1].number if job.attempts else None
    change = {"status": job.status.value, "reason": job.reason, "message": job.message, "attempt": attempt}
    return Entry(kind="status", time=time or utc_now(), data=change)


def note_entry(text: str) -> Entry:
    """An event for people."""
    return Entry(kind="note", time=utc_now(), data={"text": text})


def metrics_entries(block: Block) -> Iterator[Entry]:
    """The rows as events."""
    for number, step, time, values in block.rows():
        data = {"step": step, "values": values}
        yield Entry(id=str(number), kind="metrics", time=datetime.fromtimestamp(time, UTC), data=data)


def metrics_row(entry: Entry, number: int) -> Measurement:
    """The row of an event of the kind `metrics`."""
    return Measurement(number, entry.data["step"], entry.time.timestamp(), entry.data["values"])


def entry_number(entry_id: str) -> int:
    """An entry's number in its feed; 0, before every entry, for "". Raises Rejected."""
    if not entry_id:
        return 0
    if not (entry_id.isascii() and entry_id.isdigit() and len(entry_id) <= _LONGEST_ID):
        sentence = f"{entry_id[:64]!r} is not the id of an entry of this feed."
        raise Rejected(sentence, [Problem("/after", sentence)])
    return int(entry_id)


class Whose(Stored):
    """A filter of listings by owner and project. projects: only those in one of these; None: in any.

    first: the user whose own come before all others.
    """

    owner: str | None = None
    projects: tuple[str, ...] | None = None
    first: str | None = None


ANYBODYS = Whose()


# Instead of a sweep's id.
NO_SWEEP, FOLDED = "none", "folded"


class JobQuery(Stored):
    """The filters of a listing; None matches any job. labels: every one must match.

    search: a part of the name, of the note or of the environment's id, in any case. sweep: the id of the one
    whose trials are wanted; NO_SWEEP: no trials; FOLDED: of its trials only the first in the list's order.
    sort: None: newest first, one's own before those of others.
    """

    status: JobStatus | None = None
    kind: JobKind | None = None
    environment: str | None = None
    name: str | None = None
    search: str | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    sweep: str | None = None
    sort: Sort | None = None
    whose: Whose = ANYBODYS


@dataclass(frozen=True)
class Idempotency:
    """A client's key for a submission, and a fingerprint of the body it came with.

    user: whose key it is; two users may have the same.
    """

    key: str
    fingerprint: str
    user: str | None = None


@dataclass(frozen=True)
class JobPage:
    """Some jobs in the order of the list, and the cursor of the next page; None at the end.

    of_newest: how many of the newest jobs a sorted list is of, where it leaves older ones out.
    """

    jobs: Sequence[Job | UnreadableJob]
    next_cursor: str | None
    of_newest: int | None = None


@dataclass(frozen=True)
class Chunk:
    """A finished part of a feed, in the object store: entries `first` to `last`, each a line of JSON, or the
    metrics among them as a `Block`."""

    channel: Channel
    first: int
    last: int
    key: str
    size: int
    sha256: str


@dataclass(frozen=True)
class FeedPart:
    """A feed after a position, up to entry number `last`: the chunks that reach beyond that position, and
    the entries that lie in none; both in their order.

    Chunks may have entries after `last`, which belong to the next part. status: the job's at that moment.
    is_end: whether the feed had no more entries then.
    """

    chunks: Sequence[Chunk]
    entries: Sequence[Entry]
    status: JobStatus
    last: int
    is_end: bool


@dataclass(frozen=True)
class MetricsPart:
    """The metrics of a feed after a position, up to entry number `last`: the chunks that reach beyond that
    position, and the blocks that lie in none. is_end: as in `FeedPart`.

    blocks: each the number of its first row, and its bytes.
    """

    chunks: Sequence[Chunk]
    blocks: Sequence[tuple[int, bytes]]
    last: int
    is_end: bool


@dataclass(frozen=True)
class Dispatch:
    """A message to hand over to RQ. task: `attempt`, or the kind of a file to validate; subject: the id of
    the job or of the file."""

    task: Literal["attempt"] | KindName
    subject: str
    attempt: int = 0


@dataclass(frozen=True)
class Renewal:
    """What an attempt hears when it renews its lease. room_for: in words, the job for which it must make
    room; None if it may go on."""

    status: JobStatus
    room_for: str | None = None


@dataclass(frozen=True)
class Mark:
    """A job's version and the lengths of its feeds; a different mark means a change."""

    version: int
    num_events: int
    num_logs: int


class JobStore(NewsStore, QuotaStore, RetentionStore, Uploads, UsageStore, WorkerStore, Protocol):
    """The record. Every method raises RecordsUnavailable when the store cannot be reached.

    Each write is one transaction. `save` is a compare-and-set on the version; `renew` and `record` carry an
    attempt's token, and raise LeaseLost when another attempt (or none) holds the job. Leases use the
    store's own clock. A write whose answer was lost may be sent again: the second one changes nothing.
    """

    def now(self) -> datetime:
        """The store's clock in UTC; a change of that clock shows here within a second."""
        ...

    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        """Store a new job and its dispatch, and return it; or, for a key seen before with the same
        fingerprint, the job stored then. Raises IdempotencyKeyReused for another fingerprint, JobExists for
        an id that exists, JobNotFound if the job whose checkpoint it needs was deleted, ClipsNotFound if
        clips that it names were, and QuotaExceeded if as many jobs of its owner or project are queued as may
        be; that is exact however many add jobs at once. Keys are remembered for 24 hours."""
        ...

    def import_job(
        self,
        job: Job,
        chunks: Sequence[Chunk],
        events: Sequence[Entry],
        *,
        idempotency: Idempotency | None = None,
    ) -> bool:
        """Store an ended job, the chunks of its feeds, and the events that follow them; all of it or nothing.

        False if the id exists or the key is remembered; see `add`. Raises JobUnreadable where the store
        cannot hold the record.
        """
        ...

    def remembered(self, idempotency: Idempotency) -> Job | None:
        """The job that an earlier submission with this key created, if any. Raises IdempotencyKeyReused."""
        ...

    def find(self, job_id: str) -> Job | UnreadableJob:
        """The job with its latest progress. Raises JobNotFound."""
        ...

    def get(self, job_id: str) -> Job:
        """Like `find`, for a readable record. Raises JobNotFound, JobUnreadable."""
        ...

    def owner_of(self, job_id: str) -> Ownership:
        """Whose the job is; that never changes. Raises JobNotFound."""
        ...

    def save(self, job: Job, *, lease: timedelta | None = None, note: str | None = None) -> None:
        """Store the next version; with `lease`, also start the present attempt's lease.

        Raises StaleJob unless the stored version is the one before, JobNotFound where there is none.
        The progress in `job` is not stored: `record` does that. A change of status appends a `status`
        entry ({"status", "reason", "message", "attempt"}) to the events, and `note` one of its kind; a job
        that becomes queued gets a dispatch. A job that no attempt holds has no lease.
        """
        ...

    def patch(self, job_id: str, patch: JobPatch) -> Job | UnreadableJob:
        """Change its name, labels and note, whatever its status, and return it.

        Its version stays, so that the patch and what an attempt writes meanwhile take nothing from each
        other. Raises JobNotFound; JobUnreadable where its specification is no object; Rejected where that
        would be too large.
        """
        ...

    def take_back(self, job: Job) -> None:
        """Store the next version as `save` does, if the lease has run out; the same statement checks both.

        Raises StaleJob where the attempt has renewed its lease meanwhile.
        """
        ...

    def delete(self, job_id: str, version: int) -> None:
        """Delete the job, its feeds and its lease, and remember that its objects are to be removed.

        Raises JobNotFound, StaleJob where its version has changed, and JobInUse while an unfinished job needs
        a checkpoint of it, or an unfinished sweep names it: one transaction checks that and deletes.
        """
        ...

    def deletions(self, *, before: timedelta = timedelta(0)) -> Sequence[str]:
        """The ids of jobs that were deleted at least so long ago, and whose objects may be there still."""
        ...

    def deletion_ended(self, job_id: str) -> None:
        """Forget a deleted job, whose objects are gone."""
        ...

    def list(
        self, query: JobQuery, *, cursor: str | None = None, limit: int = 50, brief: bool = False
    ) -> JobPage:
        """Some of the jobs that match, in the order that the query wants. Raises Rejected for a wrong cursor.

        cursor: the `next_cursor` of an earlier page. Sorted lists are of the newest 100,000 jobs.

        A page of long records has fewer than `limit`. brief: each has only its newest attempts, without
        `details`, and the newest of its files of each role, without long `metadata`.
        """
        ...

    def expired(self) -> Iterable[Job]:
        """Every held job whose lease has run out, oldest first; none during the wait that `beat` describes,
        or if the last beat was half a lease ago."""
        ...

    def beat(self, lease: timedelta) -> None:
        """Record that the reconciler watches the leases.

        After a gap of half a lease (the store was unavailable, its clock was set, or no reconciler ran),
        `expired` and `take_back` find nothing for a whole lease: attempts get that time to renew theirs.
        """
        ...

    def waiting(
        self, room: Mapping[str, int] | None = None, but_not: Collection[tuple[str, int]] = ()
    ) -> Sequence[Dispatch]:
        """The next attempt of queued jobs that may begin, and every file that waits for its validation.

        room: for each queue how many of its jobs, the oldest first; the queues in their order. None: as many
        as a queue holds. but_not: attempts to be left out, each
        by its job and number.
        """
        ...

    def queue_counts(self) -> Sequence[QueueCount]:
        """Each queue with queued or held jobs, and that of files that wait for their validation."""
        ...

    def queues_of_several_hosts(self) -> Collection[str]:
        """The queues of all queued jobs on several hosts."""
        ...

    def jobs_of(self, job_ids: Collection[str]) -> Mapping[str, Job | UnreadableJob]:
        """These jobs, read at once; unknown ones are left out."""
        ...

    def take_turn(  # noqa: PLR0913 # Who, where, and what it is told.
        self,
        queues: Sequence[str],
        worker: str,
        *,
        lease: timedelta,
        secret: str,
        details: Mapping[str, Any] | None = None,
        fits: Callable[[Job], bool] = lambda job: True,
        told: str = "",
        offer: Offer | None = None,
    ) -> Job | None:
        """Claim the job whose turn it is, by `core.jobs.turns`, among the queued ones of these queues; None
        if none may start now. Two claims never get the same one.

        secret: of the claim's token; a call that is repeated with the same one returns the job claimed then.
        fits: whether this worker can run the job; it has to be quick. told: the job of RQ's message, which
        counts for the queues also where an older version wrote its row. offer: of a worker that belongs to a
        pool; the attempt's details then say which GPUs the job was given (`GIVEN`). Raises NothingFits if
        jobs wait for which the offer is too small, or that would delay a larger one.
        """
        ...

    def make_room(self) -> Mapping[str, Sequence[str]]:
        """Tell running jobs to make room for waiting ones, by `core.jobs.preemption`: their attempts hear of
        it when they renew their leases. Returns by the waiting job's id those that were told. The choice and
        the telling are one transaction; while another process is at it, nothing is done."""
        ...

    def rooms(self) -> Mapping[str, Sequence[str]]:
        """By the waiting job's id those that make room for it now, in words for readers of its project."""
        ...

    def turn_facts(self) -> TurnFacts:
        """What a forecast of the waiting jobs needs: reads all that wait, so ask now and then."""
        ...

    def keep_peak(self, alike: str, num_bytes: int) -> None:
        """Remember the most that a training has had of a GPU's memory, for those like it."""
        ...

    def forget_peak(self, alike: str) -> None:
        """Forget what `keep_peak` was told of such trainings: it was not enough."""
        ...

    def undispatched(self) -> Sequence[Dispatch]:
        """Dispatches that were committed, may begin, and were not handed over to RQ yet; oldest first."""
        ...

    def dispatched(self, dispatches: Sequence[Dispatch]) -> None:
        """Record that RQ has received these."""
        ...

    def renew(self, job_id: str, token: str, lease: timedelta) -> Renewal:
        """Extend the lease of the attempt that holds the job. Raises LeaseLost."""
        ...

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
        """Append to a feed, and replace the progress where given; all or nothing. Raises LeaseLost.

        write_id: a write that is repeated with the same one, right after the first, changes nothing.
        """
        ...

    def feed(self, job_id: str, channel: Channel, *, after: int = 0, limit: int = 1000) -> FeedPart:
        """The feed after entry number `after`, as of one moment: up to `limit` entries, and no more than a
        few chunks. Raises JobNotFound."""
        ...

    def feed_metrics(self, job_id: str, *, after: int = 0) -> MetricsPart:
        """The metrics among the events after entry number `after`, as of one moment, and no more than a few
        chunks. Raises JobNotFound."""
        ...

    def long_feeds(
        self, *, max_bytes: int, max_age: timedelta, max_metrics_bytes: int
    ) -> Sequence[tuple[str, Channel]]:
        """The feeds that are due to become a chunk: those of ended jobs; those with more bytes than that; and
        those with an entry, but for metrics, older than `max_age`."""
        ...

    def oldest_entries(
        self, job_id: str, channel: Channel, *, limit: int, max_bytes: int = 2**40
    ) -> Sequence[Entry]:
        """The oldest entries but metrics that lie in no chunk yet; as many as have these bytes, and one
        more."""
        ...

    def oldest_metrics(self, job_id: str, *, max_bytes: int = 2**40) -> Sequence[tuple[int, bytes]]:
        """The oldest blocks of metrics that lie in no chunk yet, as `MetricsPart` has them; as many as have
        these bytes, and one more."""
        ...

    def replace_by_chunk(self, job_id: str, chunk: Chunk) -> None:
        """Record the chunk and drop the entries that it holds; does nothing if that was done already, or the
        job was deleted."""
        ...

    def marks(self, job_ids: Collection[str]) -> Mapping[str, Mark]:
        """The marks of these jobs; unknown jobs are left out."""
        ...

    def jobs_needing_checkpoint_of(self, job_id: str) -> Sequence[tuple[str, int | None]]:
        """The ids of unfinished jobs that need a checkpoint of this one, each with the step that it names."""
        ...

    def objects_named(self, job_ids: Collection[str]) -> Collection[str]:
        """The keys of all objects that these jobs name: artifacts and chunks."""
        ...

    def chunks(self, job_ids: Collection[str]) -> Mapping[str, Sequence[Chunk]]:
        """The chunks of these jobs' feeds; jobs without any are left out."""
        ...

    def replace_chunk(self, job_id: str, lost: Chunk, found: Chunk) -> None:
        """Replace the object of the same entries; does nothing if that was done already."""
        ...

    def tidy(self) -> None:
        """Forget expired idempotency keys and workers, and deliveries that ended long ago."""
        ...

    def ping(self) -> None:
        """Make sure that the store answers. Raises RecordsUnavailable."""
        ...
