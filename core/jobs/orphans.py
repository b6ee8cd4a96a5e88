"""Removes objects that no record names, once they are a day old."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import groupby

import structlog

from core.errors import JobUnreadable, ModelNotFound, ObjectNotFound
from core.jobs import columns
from core.jobs.record_copy import read_copy
from core.jobs.store import JobStore, Mark
from core.storage import keys
from core.storage.objects import ObjectInfo, ObjectStore

log = structlog.get_logger()

# An object is written before a record names it, and may be read for a while after the record drops it.
GRACE = timedelta(hours=24)
# A page of an S3 listing.
_BATCH = 1000

Folders = Mapping[str, Sequence[ObjectInfo]]


@dataclass
class _Seen:
    """Counts of one round."""

    known_jobs: int = 0
    unknown_jobs: int = 0
    unknown_objects: int = 0
    unknown_files: int = 0  # without the copies of records
    jobs_behind: int = 0
    removed: int = 0


def sweep(*, store: JobStore, objects: ObjectStore, grace: timedelta = GRACE) -> Iterator[None]:
    """Remove objects that no record names, of known jobs, and whole models that the record does not know.

    A round through a large bucket takes minutes. It yields after each step: a page of the listing with two
    queries, or one object removed.

    Files of an import that was interrupted before it reached the record are removed, too: the folder of an
    unknown job holds them alone, while one that was recorded has a copy of its record, or a part of a feed.

    Three kinds of objects are left alone, because a database that was restored to an older moment has
    forgotten them, and `gaitway recover` can bring them back: those of other jobs that the record does not
    know; all of a job whose copy is newer than its record; and those that a job's copy names.
    """
    before = store.now() - grace
    seen = _Seen()
    for batch in batches(folders(objects.list(keys.jobs()))):
        yield from _of_jobs(batch, before, store, objects, seen)
    # A record that has forgotten jobs may have forgotten models, too.
    if seen.known_jobs and not seen.unknown_files:
        for batch in batches(folders(objects.list(keys.models()))):
            yield from _of_models(batch, before, store, objects, seen)
    if seen.removed:
        log.info("orphans_removed", num_objects=seen.removed)
    if seen.unknown_objects or seen.jobs_behind:
        log.warning(
            "objects_left_alone",
            unknown_jobs=seen.unknown_jobs,
            unknown_objects=seen.unknown_objects,
            jobs_behind_their_copies=seen.jobs_behind,
            remedy="`gaitway recover` lists them",
        )


def folders(found: Iterable[ObjectInfo]) -> Iterator[tuple[str, Sequence[ObjectInfo]]]:
    """A listing in key order, grouped by the second part of its keys: a job's id or a model's hash."""
    for name, infos in groupby(found, lambda info: keys.job_of(info.key)):
        yield name, list(infos)


def batches(found: Iterable[tuple[str, Sequence[ObjectInfo]]]) -> Iterator[Folders]:
    """Batches of folders, each with about a thousand objects."""
    batch: dict[str, Sequence[ObjectInfo]] = {}
    num_objects = 0
    for name, infos in found:
        batch[name] = infos
        num_objects += len(infos)
        if num_objects >= _BATCH:
            yield batch
            batch, num_objects = {}, 0
    if batch:
        yield batch


def _of_jobs(
    batch: Folders, before: datetime, store: JobStore, objects: ObjectStore, seen: _Seen
) -> Iterator[None]:
    known = store.marks(batch)
    named = set(store.objects_named(known))
    for job_id, chunks in store.chunks(known).items():
        named |= {columns.key(job_id, group) for group in columns.groups(chunks)}
    for job_id, infos in batch.items():
        files = [info for info in infos if not keys.is_record(info.key)]
        if job_id in known:
            seen.known_jobs += 1
            unnamed = [info.key for info in files if info.key not in named and _is_older(info, before)]
            orphans = _not_in_the_copy(job_id, unnamed, known[job_id], objects, seen)
            yield from _remove(orphans, before, objects, seen)
        elif all(keys.is_imported(info.key) for info in infos):
            old = [info.key for info in infos if _is_older(info, before)]
            yield from _remove(old, before, objects, seen)
        else:
            seen.unknown_jobs += 1
            seen.unknown_objects += len(infos)
            seen.unknown_files += len(files)
    yield


def _not_in_the_copy(
    job_id: str, unnamed: Sequence[str], mark: Mark, objects: ObjectStore, seen: _Seen
) -> Sequence[str]:
    """The keys that the record's copy does not name either; none if the copy is newer than the record."""
    if not unnamed:
        return ()
    try:
        copy = read_copy(job_id, objects)
    except JobUnreadable:
        return ()
    if copy is None:
        return unnamed
    if copy.version > mark.version:
        seen.jobs_behind += 1
        return ()
    copied = {artifact.key for artifact in copy.artifacts}
    return [key for key in unnamed if key not in copied]


def _of_models(
    batch: Folders, before: datetime, store: JobStore, objects: ObjectStore, seen: _Seen
) -> Iterator[None]:
    for name, infos in batch.items():
        if all(_is_older(info, before) for info in infos) and not _is_model(name, store):
            yield from _remove([info.key for info in infos], before, objects, seen)
    yield


def _is_model(name: str, store: JobStore) -> bool:
    try:
        store.find_model(f"sha256:{name}")
    except ModelNotFound:
        return False
    return True


def _remove(orphans: Collection[str], before: datetime, objects: ObjectStore, seen: _Seen) -> Iterator[None]:
    for key in orphans:
        try:
            # It may have been written again since the listing, and be about to be named.
            is_old = _is_older(objects.info(key), before)
        except ObjectNotFound:
            continue
        if is_old:
            objects.delete_prefix(key)
            seen.removed += 1
        yield


def _is_older(info: ObjectInfo, before: datetime) -> bool:
    """Whether it was written before then; false if the store gives no time."""
    return info.modified_at is not None and info.modified_at < before
