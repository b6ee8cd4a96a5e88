"""The metrics of eight chunks at a time as columns: one object, read many times as fast as the chunks' lines.

The columns are a copy, and may be lost. Their key is made from the hashes of the chunks that the record
names, so that a reader finds those of exactly these chunks, or none, and then reads the lines.
"""

import hashlib
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain

import structlog

from core.bounds import MOST_METRICS
from core.errors import ObjectNotFound
from core.jobs.curves import Curves, decode, encode
from core.jobs.measured import in_chunk
from core.jobs.store import Chunk, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()

GROUP = 8


def groups(chunks: Iterable[Chunk]) -> Iterator[Sequence[Chunk]]:
    """The first eight chunks of a job's events, the next eight, and so on; without those that are fewer."""
    events = [chunk for chunk in chunks if chunk.channel == "events"]
    for start in range(0, len(events) - GROUP + 1, GROUP):
        yield events[start : start + GROUP]


def completed(newest: Chunk, named: Iterable[Chunk]) -> Sequence[Chunk]:
    """The group that this chunk completes behind those that the record names; empty if it completes none."""
    earlier = [chunk for chunk in named if chunk.last < newest.first]
    return next((group for group in groups([*earlier, newest]) if newest in group), ())


def key(job_id: str, group: Sequence[Chunk]) -> str:
    digest = hashlib.sha256("".join(chunk.sha256 for chunk in group).encode()).hexdigest()
    return keys.columns(job_id, group[0].first, digest)


def write(job_id: str, group: Sequence[Chunk], bodies: Sequence[bytes], objects: ObjectStore) -> None:
    """bodies: the bytes of the group's chunks. Of very many metrics there are no columns, whose names would
    take more memory than all else here. Raises StorageUnavailable."""
    names = set[str]()
    for _, said in chain.from_iterable(map(in_chunk, bodies)):
        names.update(said.values)
        if len(names) > MOST_METRICS:
            log.warning("columns_skipped", job=job_id, first=group[0].first, most=MOST_METRICS)
            return
    curves = Curves.of(chain.from_iterable(map(in_chunk, bodies)))
    objects.put(key(job_id, group), encode(curves), media_type="application/msgpack")


def read(
    job_id: str, names: Collection[str] | None, *, store: JobStore, objects: ObjectStore
) -> Iterator[tuple[Curves, int]]:
    """The metrics of each group from the feed's beginning, with the number of its last entry.

    They end before the first group whose columns are missing or damaged, which the log tells: the rest has
    to be read from the feed. names: only these metrics; None: all.
    Raises RecordsUnavailable, StorageUnavailable.
    """
    for group in groups(store.chunks([job_id]).get(job_id, ())):
        try:
            curves = decode(objects.get(key(job_id, group)), names)
        except ObjectNotFound:  # The chunks are older than columns are, or the bucket cannot give these.
            log.info("columns_missing", job=job_id, first=group[0].first)
            return
        if curves is None:
            log.error("columns_damaged", key=key(job_id, group))
            return
        yield curves, group[-1].last
