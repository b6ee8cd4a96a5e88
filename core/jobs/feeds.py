"""A job's feeds, read across the record and the object store, and moved from the first to the second.

The record holds the newest entries. Older ones lie in chunks: immutable objects, which the record names.
"""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import timedelta
from itertools import accumulate, takewhile

import msgspec
import structlog

from core.errors import JobNotFound, ObjectDamaged, ObjectNotFound
from core.jobs import columns
from core.jobs.measured import Measured, in_chunk
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Chunk, Entry, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore
from core.storage.whole import read_whole

log = structlog.get_logger()

# A chunk is made from this many bytes, or after this time, or at the job's end.
MAX_BYTES = 256 * 1024
MAX_AGE = timedelta(minutes=10)
_MAX_ENTRIES = 2000
_MAX_CHUNK_BYTES = 2**20
PAGE = 1000
# Reading these takes as long as reading a page of entries.
METRICS_PAGE = 8000
# Its step, its time and the row take as much time and memory.
_VALUES_OF_A_ROW = 7


@dataclass(frozen=True)
class FeedPage:
    """A part of a feed, oldest first. status, is_end: as of that moment, see `FeedPart`."""

    entries: Sequence[Entry]
    status: JobStatus
    is_end: bool


@dataclass(frozen=True)
class MetricsPage:
    """The metrics in a part of a feed, oldest first. last: the number of that part's last entry."""

    measured: Sequence[Measured]
    last: int
    is_end: bool


def read(  # noqa: PLR0913 # Where from, which feed, which part of it.
    job_id: str,
    channel: Channel,
    *,
    store: JobStore,
    objects: ObjectStore,
    after: int = 0,
    kind: str | None = None,
    limit: int = PAGE,
    max_values: int | None = None,
) -> Sequence[Entry]:
    """Entries later than number `after`, oldest first; of one kind where given. Empty at the feed's end.

    max_values: fewer where these and one more would have more values of metrics together. A row itself counts
    as `_VALUES_OF_A_ROW`.

    Raises the errors of `read_page`.
    """
    # Entries of one kind may be rare: small pages would need many reads to find the last few.
    at_once = limit if kind is None else PAGE
    found: list[Entry] = []
    for page in read_pages(job_id, channel, store=store, objects=objects, after=after, at_once=at_once):
        found += [entry for entry in page if kind in (None, entry.kind)]
        if len(found) >= limit or (max_values is not None and _num_within(found, max_values) < len(found)):
            break
    return found[: limit if max_values is None else min(limit, _num_within(found, max_values))]


def _num_within(entries: Sequence[Entry], max_values: int) -> int:
    """How many of these, at least one, have at most so many values together."""
    sums = accumulate(_VALUES_OF_A_ROW + len(entry.data.get("values", ())) for entry in entries)
    return max(1, sum(1 for _ in takewhile(lambda total: total <= max_values, sums)))


def read_pages(
    job_id: str,
    channel: Channel,
    *,
    store: JobStore,
    objects: ObjectStore,
    after: int = 0,
    at_once: int = PAGE,
) -> Iterator[Sequence[Entry]]:
    """All entries later than number `after`, oldest first, in pages; only one page is in memory at a time.

    Raises the errors of `read_page`.
    """
    while True:
        page = read_page(job_id, channel, after, at_once, store=store, objects=objects)
        yield page.entries
        if page.is_end:
            return
        after = int(page.entries[-1].id)


def read_page(
    job_id: str, channel: Channel, after: int, limit: int, *, store: JobStore, objects: ObjectStore
) -> FeedPage:
    """At least `limit` entries after number `after`, if there are that many.

    A `note` replaces a part that the object store has lost or cannot give whole, and says so.
    Raises JobNotFound, RecordsUnavailable, StorageUnavailable.
    """
    part = store.feed(job_id, channel, after=after, limit=limit)
    found: list[Entry] = []
    for chunk in part.chunks:
        found += [entry for entry in _entries_of(chunk, job_id, store, objects) if int(entry.id) > after]
        if len(found) >= limit:
            return FeedPage(found, part.status, is_end=False)
    return FeedPage([*found, *part.entries], part.status, part.is_end)


def read_metrics(
    job_id: str, after: int, limit: int, *, store: JobStore, objects: ObjectStore
) -> MetricsPage:
    """At least `limit` metrics of the feed `events` after entry number `after`, if there are that many.

    Several times as fast as `read_page`. A part that is lost or damaged in the object store has none.
    Raises the errors of `read_page`.
    """
    part = store.feed_metrics(job_id, after=after, limit=limit)
    found, last = list[Measured](), after
    for chunk in part.chunks:
        body = _body_of(chunk, job_id, store, objects)
        found += [] if isinstance(body, str) else in_chunk(body, after)
        last = chunk.last
        if len(found) >= limit:
            return MetricsPage(found, last, is_end=False)
    return MetricsPage([*found, *part.behind], max(last, part.last), part.is_end)


def _entries_of(chunk: Chunk, job_id: str, store: JobStore, objects: ObjectStore) -> Iterable[Entry]:
    body = _body_of(chunk, job_id, store, objects)
    if isinstance(body, str):
        return [_gap(chunk, body, store)]
    return map(Entry.model_validate_json, body.splitlines())


def _body_of(chunk: Chunk, job_id: str, store: JobStore, objects: ObjectStore) -> bytes | str:
    """The chunk's bytes, or what has become of them.

    Raises StorageUnavailable; JobNotFound if the job was deleted meanwhile, and its chunks with it.
    """
    try:
        return read_whole(chunk.key, chunk.sha256, objects)
    except ObjectNotFound as error:
        store.find(job_id)
        # The record stays as it is: a bucket restored from a backup has the part again.
        is_damaged = isinstance(error, ObjectDamaged)
        log.error("feed_damaged" if is_damaged else "feed_lost", key=chunk.key, error=error.detail)
        return "damaged in the object store" if is_damaged else "lost from the object store"


def _gap(lost: Chunk, how: str, store: JobStore) -> Entry:
    """The entry that replaces a chunk, and says that its entries were `how`.

    It has the chunk's last number, so that readers continue after it.
    """
    which = f"Entries {lost.first} to {lost.last}" if lost.first < lost.last else f"Entry {lost.last}"
    text = f"{which} of this feed {'were' if lost.first < lost.last else 'was'} {how}."
    return Entry(id=str(lost.last), kind="note", time=store.now(), data={"text": text})


def close_gap(job_id: str, lost: Chunk, *, store: JobStore, objects: ObjectStore) -> None:
    """Replace a lost chunk by one with a single entry, which says what was lost."""
    body = _gap(lost, "lost from the object store", store).model_dump_json().encode() + b"\n"
    store.replace_chunk(job_id, lost, _stored(job_id, lost.channel, lost.first, lost.last, body, objects))


def compact(*, store: JobStore, objects: ObjectStore) -> int:
    """Move due entries into chunks; returns how many feeds were due.

    An object is written before the record names it, under a key made from its content: repeating this, or
    running it in two places at once, does no harm.
    """
    due = store.long_feeds(max_bytes=MAX_BYTES, max_age=MAX_AGE)
    for job_id, channel in due:
        entries = store.oldest_entries(job_id, channel, limit=_MAX_ENTRIES, max_bytes=_MAX_CHUNK_BYTES)
        if entries:  # Otherwise another process was faster, or the job was deleted.
            chunk = _chunk(job_id, channel, entries, objects)
            if channel == "events":
                _store_columns(job_id, chunk, store, objects)
            store.replace_by_chunk(job_id, chunk)
    return len(due)


def _chunk(job_id: str, channel: Channel, entries: Sequence[Entry], objects: ObjectStore) -> Chunk:
    """Store these entries as an object; returns its chunk."""
    body = b"".join(entry.model_dump_json().encode() + b"\n" for entry in entries)
    return _stored(job_id, channel, int(entries[0].id), int(entries[-1].id), body, objects)


def _stored(job_id: str, channel: Channel, first: int, last: int, body: bytes, objects: ObjectStore) -> Chunk:
    digest = hashlib.sha256(body).hexdigest()
    key = keys.chunk(job_id, channel, first, digest)
    objects.put(key, body, media_type="application/jsonl")
    return Chunk(channel, first, last, key, len(body), digest)


def _store_columns(job_id: str, newest: Chunk, store: JobStore, objects: ObjectStore) -> None:
    """Store the columns of the group that this chunk completes, if it completes one.

    Before the record names the chunk, so that both are repeated if this is interrupted. A group with a chunk
    that is lost or damaged, or has metrics that cannot be read, gets none: the feed is moved all the same.
    """
    group = columns.completed(newest, store.chunks([job_id]).get(job_id, ()))
    try:
        bodies = [_body_of(chunk, job_id, store, objects) for chunk in group]
        whole = [body for body in bodies if isinstance(body, bytes)]
        if group and len(whole) == len(group):
            columns.write(job_id, group, whole, objects)
    except JobNotFound:  # It was deleted meanwhile.
        return
    except (msgspec.MsgspecError, OverflowError) as error:
        log.error("metrics_unreadable", job=job_id, error=str(error))
