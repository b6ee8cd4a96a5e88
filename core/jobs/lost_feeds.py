"""Feeds after a disaster: chunks that the record has lost, and gaps where the bucket has lost them."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from itertools import groupby
from typing import get_args

from core.errors import ObjectNotFound
from core.jobs.store import Channel, Chunk, Entry, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

_FIRST_DIGITS = 12  # of a chunk's name
_MAX_ENTRIES = 100_000


def chunks_beyond(
    job_id: str, found: Iterable[str], *, store: JobStore, objects: ObjectStore
) -> Sequence[Chunk]:
    """The chunks that continue each feed of the record; the record may not know the job at all.

    found: the keys of the job's objects. A chunk that contradicts the record ends the search: the job has
    run differently since the restore.
    """
    known = store.chunks([job_id]).get(job_id, ())
    beyond: list[Chunk] = []
    for channel in get_args(Channel):
        rows = store.oldest_entries(job_id, channel, limit=_MAX_ENTRIES)
        last = max((chunk.last for chunk in known if chunk.channel == channel), default=0)
        for chunk, said in _chunks(job_id, channel, found, objects):
            if chunk.first <= last:
                continue
            if any(said.get(row.id) != row for row in rows if last < int(row.id) <= chunk.last):
                break
            beyond.append(chunk)
            last = chunk.last
    return beyond


def gap(lost: Chunk, how: str, time: datetime) -> Entry:
    """The entry that replaces a chunk, and says that its entries were `how`.

    It has the chunk's last number, so that readers continue after it.
    """
    which = f"Entries {lost.first} to {lost.last}" if lost.first < lost.last else f"Entry {lost.last}"
    text = f"{which} of this feed {'were' if lost.first < lost.last else 'was'} {how}."
    return Entry(id=str(lost.last), kind="note", time=time, data={"text": text})


def close_gap(job_id: str, lost: Chunk, *, store: JobStore, objects: ObjectStore) -> None:
    """Replace a lost chunk by one with a single entry, which says what was lost."""
    entry = gap(lost, "lost from the object store", store.now())
    body = entry.model_dump_json().encode() + b"\n"
    digest = hashlib.sha256(body).hexdigest()
    key = keys.chunk(job_id, lost.channel, lost.first, digest)
    objects.put(key, body, media_type="application/jsonl")
    store.replace_chunk(job_id, lost, Chunk(lost.channel, lost.first, lost.last, key, len(body), digest))


def _chunks(
    job_id: str, channel: Channel, found: Iterable[str], objects: ObjectStore
) -> Iterator[tuple[Chunk, dict[str, Entry]]]:
    """The channel's chunks in order with their entries; of several with the same first entry, the longest."""
    prefix = f"{keys.job(job_id)}{channel}/"
    names = sorted(key.removeprefix(prefix) for key in found if key.startswith(prefix))
    for _, alike in groupby(names, lambda name: name[:_FIRST_DIGITS]):
        read = [_read(job_id, channel, f"{prefix}{name}", objects) for name in alike]
        whole = [one for one in read if one is not None]
        if whole:
            yield max(whole, key=lambda one: one[0].last)


def _read(
    job_id: str, channel: Channel, key: str, objects: ObjectStore
) -> tuple[Chunk, dict[str, Entry]] | None:
    """The chunk and its entries; None where the object does not match its key."""
    try:
        body = objects.get(key)
        said = [Entry.model_validate_json(line) for line in body.splitlines()]
        first, last = int(said[0].id), int(said[-1].id)
    except (ObjectNotFound, ValueError, IndexError):
        return None
    digest = hashlib.sha256(body).hexdigest()
    if key != keys.chunk(job_id, channel, first, digest):
        return None
    return Chunk(channel, first, last, key, len(body), digest), {entry.id: entry for entry in said}
