"""A job's feeds, read across the record and the object store, and moved from the first to the second.

The record holds the newest entries. Older ones lie in chunks: immutable objects, which the record names.
"""

import hashlib
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from typing import Literal

import msgspec
import structlog

from core.errors import ObjectDamaged, ObjectNotFound
from core.jobs.metrics import Block, Curves
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Chunk, Entry, JobStore, metrics_entries
from core.storage import keys
from core.storage.objects import ObjectStore, read_whole

log = structlog.get_logger()

# A chunk is made from this many bytes, or after this time, or at the job's end.
MAX_BYTES = 256 * 1024
MAX_AGE = timedelta(minutes=10)
# One of metrics is not made for its age: a curve is read from all of them, so that they are few and large.
MAX_METRICS_BYTES = 2**20
_MAX_ENTRIES = 2000
_MAX_CHUNK_BYTES = 2**20
# A page of a stream is encoded at once. An entry counts as one value.
_MAX_VALUES = 2**14
PAGE = 1000
_encoder, _decoder = msgspec.json.Encoder(), msgspec.json.Decoder(Entry)


@dataclass(frozen=True)
class FeedPage:
    """A part of a feed, oldest first, up to entry number `last`. status, is_end: as in `FeedPart`."""

    entries: Sequence[Entry]
    status: JobStatus
    last: int
    is_end: bool


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
    is_end = False
    while not is_end:
        page = read_page(job_id, channel, after, at_once, store=store, objects=objects)
        yield page.entries
        after, is_end = page.last, page.is_end


def read_page(
    job_id: str, channel: Channel, after: int, limit: int, *, store: JobStore, objects: ObjectStore
) -> FeedPage:
    """At least `limit` entries after number `after`, if there are that many; fewer where they are long.

    A `note` replaces a part that the object store has lost or cannot give whole, and says so.
    Raises JobNotFound, RecordsUnavailable, StorageUnavailable.
    """
    part = store.feed(job_id, channel, after=after, limit=limit)
    found, last, is_end = list(part.entries), part.last, part.is_end
    for number, chunk in enumerate(part.chunks, 1):
        if chunk.first > last:
            break
        size = 0
        for entry in _entries_of(chunk, after, job_id, store, objects):
            found.append(entry)
            size += 1 + len(entry.data.get("values", ()))
            if size > _MAX_VALUES:  # The chunk may have more.
                last, is_end = min(last, int(entry.id)), False
                break
        if number < len(part.chunks):  # The entries before the next chunk are known.
            page = _page(found, part.status, min(last, part.chunks[number].first - 1), is_end=False)
            if len(page.entries) >= limit:
                return page
    return _page(found, part.status, last, is_end=is_end)


def _page(found: Iterable[Entry], status: JobStatus, last: int, *, is_end: bool) -> FeedPage:
    known = sorted((entry for entry in found if int(entry.id) <= last), key=lambda entry: int(entry.id))
    return FeedPage(known, status, last, is_end)


def read_metrics(
    job_id: str,
    *,
    store: JobStore,
    objects: ObjectStore,
    after: int = 0,
    names: Collection[str] | None = None,
) -> Iterator[tuple[Block, int]]:
    """The metrics among a job's events after entry number `after`, in parts, each with the number of the
    entry that it reaches to. The last part reaches to the end of the feed.

    A part that is lost or damaged in the object store has none. names: only these metrics; None: all.
    Raises the errors of `read_page`.
    """
    is_end = False
    while not is_end:
        part = store.feed_metrics(job_id, after=after)
        for chunk in part.chunks:
            body = b"" if _has_lines(chunk) else _body_of(chunk, job_id, store, objects)
            if body and not isinstance(body, str):
                yield Block.decode(body, chunk.first, names).after(after), chunk.last
        behind = Block()
        for first, body in part.blocks:
            behind.extend(Block.decode(body, first, names).after(after))
        yield behind, part.last
        after, is_end = part.last, part.is_end


def read_curves(
    job_id: str, *, store: JobStore, objects: ObjectStore, names: Collection[str] | None = None
) -> tuple[Curves, int]:
    """A job's curves, and the number of its events' last entry. As `read_metrics`."""
    curves, last = Curves(), 0
    for block, last in read_metrics(job_id, store=store, objects=objects, names=names):  # noqa: B007
        curves.extend(block)
    return curves, last


def _entries_of(
    chunk: Chunk, after: int, job_id: str, store: JobStore, objects: ObjectStore
) -> Iterable[Entry]:
    """Those after number `after`."""
    body = _body_of(chunk, job_id, store, objects)
    if isinstance(body, str):
        return [_gap(chunk, body, store)]
    if not _has_lines(chunk):
        return metrics_entries(Block.decode(body, chunk.first).after(after))
    return [entry for entry in _decoder.decode_lines(body) if int(entry.id) > after]


def _has_lines(chunk: Chunk) -> bool:
    """Whether its entries are lines. Metrics are a block, but for the note that replaces a lost one."""
    return chunk.key.endswith(".jsonl")


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
    if lost.channel == "metrics":
        text = f"The metrics from entry {lost.first} to entry {lost.last} of this feed were {how}."
    return Entry(id=str(lost.last), kind="note", time=store.now(), data={"text": text})


def close_gap(job_id: str, lost: Chunk, *, store: JobStore, objects: ObjectStore) -> None:
    """Replace a lost chunk by one with a single entry, which says what was lost."""
    body = _encoder.encode_lines([_gap(lost, "lost from the object store", store)])
    store.replace_chunk(job_id, lost, _stored(job_id, lost.channel, lost.first, lost.last, body, objects))


def compact(*, store: JobStore, objects: ObjectStore) -> int:
    """Move due entries into chunks; returns how many feeds were due.

    An object is written before the record names it, under a key made from its content: repeating this, or
    running it in two places at once, does no harm.
    """
    due = store.long_feeds(max_bytes=MAX_BYTES, max_age=MAX_AGE, max_metrics_bytes=MAX_METRICS_BYTES)
    for job_id, channel in due:
        if channel == "metrics":
            chunk = _metrics_chunk(job_id, store, objects)
        else:
            chunk = _chunk(job_id, channel, store, objects)
        if chunk is not None:  # Otherwise another process was faster, or the job was deleted.
            store.replace_by_chunk(job_id, chunk)
    return len(due)


def _chunk(job_id: str, channel: Channel, store: JobStore, objects: ObjectStore) -> Chunk | None:
    """Store the oldest entries as an object; returns its chunk."""
    entries = store.oldest_entries(job_id, channel, limit=_MAX_ENTRIES, max_bytes=_MAX_CHUNK_BYTES)
    if not entries:
        return None
    body = _encoder.encode_lines(entries)
    return _stored(job_id, channel, int(entries[0].id), int(entries[-1].id), body, objects)


def _metrics_chunk(job_id: str, store: JobStore, objects: ObjectStore) -> Chunk | None:
    """Store the oldest metrics as an object; returns its chunk."""
    block = Block()
    for first, body in store.oldest_metrics(job_id, max_bytes=MAX_METRICS_BYTES):
        block.extend(Block.decode(body, first))
    if not block.tables:
        return None
    return _stored(job_id, "metrics", block.first, block.last, block.encode(), objects, ending="msgpack")


def store_imported(
    job_id: str, metrics: Iterable[Block], lines: Iterable[str], time: datetime, objects: ObjectStore
) -> list[Chunk]:
    """Store the feeds of a job that the record does not know yet; returns their chunks.

    lines: of the log; all get this time. The keys are those of imported files, so that the sweep of orphans
    removes what an interrupted import leaves. Raises StorageUnavailable.
    """
    stored = partial(_stored, job_id, objects=objects, is_imported=True)
    chunks = [
        stored("metrics", block.first, block.last, block.encode(), ending="msgpack") for block in metrics
    ]
    for batch in _batches(lines, time):
        first, last = int(batch[0].id), int(batch[-1].id)
        chunks.append(stored("logs", first, last, _encoder.encode_lines(batch)))
    return chunks


def _batches(lines: Iterable[str], time: datetime) -> Iterator[list[Entry]]:
    """The lines as entries, in batches for a chunk each."""
    batch, size = list[Entry](), 0
    for number, text in enumerate(lines, 1):
        batch.append(Entry("line", time, {"text": text}, str(number)))
        size += len(text)
        if len(batch) == _MAX_ENTRIES or size >= _MAX_CHUNK_BYTES:
            yield batch
            batch, size = list[Entry](), 0
    if batch:
        yield batch


def _stored(  # noqa: PLR0913 # the parts of a chunk, and its place
    job_id: str,
    channel: Channel,
    first: int,
    last: int,
    body: bytes,
    objects: ObjectStore,
    *,
    ending: Literal["jsonl", "msgpack"] = "jsonl",
    is_imported: bool = False,
) -> Chunk:
    digest = hashlib.sha256(body).hexdigest()
    key = keys.chunk(job_id, channel, first, digest, ending)
    if is_imported:
        key = keys.imported(job_id, digest, f"{channel}-{first}.{ending}")
    objects.put(key, body, media_type=f"application/{ending}")
    return Chunk(channel, first, last, key, len(body), digest)
