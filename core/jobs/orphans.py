"""Compares the record with the bucket.

Removes objects that no record names, and uploads whose process died, once they are a day old; lists what the
bucket lacks, and what no record names.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import groupby
from typing import Any

import structlog

from core.errors import NotFound, ObjectNotFound, StaleJob, StorageUnavailable
from core.jobs import feeds
from core.jobs.store import JobQuery, JobStore
from core.storage import keys
from core.storage.objects import ObjectInfo, ObjectStore
from core.uploads.record import UploadStore

log = structlog.get_logger()

# An object is written before a record names it, and may be read for a while after the record drops it. No
# upload of a process that is alive takes as long.
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
    removed: int = 0


def sweep(*, store: JobStore, objects: ObjectStore, grace: timedelta = GRACE) -> Iterator[None]:
    """Remove objects that no record names, of known jobs, and whole models and clips that the record does not
    know.

    A round through a large bucket takes minutes. It yields after each step: a page of the listing with two
    queries, or one object removed.

    Files of an import that was interrupted before it reached the record are removed, too: the folder of an
    unknown job holds them alone, while one that was recorded has a part of a feed. Objects of other jobs that
    the record does not know are left alone: the database may have been restored to an older moment, and may
    be restored again.
    """
    before = store.now() - grace
    seen = _Seen()
    for batch in batches(folders(objects.list(keys.jobs()))):
        yield from _of_jobs(batch, before, store, objects, seen)
    # A record that has forgotten jobs may have forgotten models and clips, too.
    if seen.known_jobs and not seen.unknown_objects:
        for uploads in (store.models, store.clips):
            for batch in batches(folders(objects.list(uploads.kind.folder))):
                yield from _of_uploads(batch, before, uploads, objects, seen)
    if seen.removed:
        log.info("orphans_removed", num_objects=seen.removed)
    if seen.unknown_objects:
        log.warning(
            "objects_left_alone",
            unknown_jobs=seen.unknown_jobs,
            unknown_objects=seen.unknown_objects,
            remedy="`gaitway check` lists them",
        )


def folders(found: Iterable[ObjectInfo]) -> Iterator[tuple[str, Sequence[ObjectInfo]]]:
    """A listing in key order, grouped by the second part of its keys: a job's id or an upload's hash."""
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
    for job_id, infos in batch.items():
        if job_id in known:
            seen.known_jobs += 1
            orphans = [info.key for info in infos if info.key not in named and _is_older(info, before)]
            yield from _remove(orphans, before, objects, seen)
        elif all(keys.is_imported(info.key) for info in infos):
            old = [info.key for info in infos if _is_older(info, before)]
            yield from _remove(old, before, objects, seen)
        else:
            seen.unknown_jobs += 1
            seen.unknown_objects += len(infos)
    yield


def _of_uploads(
    batch: Folders, before: datetime, store: UploadStore[Any], objects: ObjectStore, seen: _Seen
) -> Iterator[None]:
    for name, infos in batch.items():
        if all(_is_older(info, before) for info in infos) and not is_upload(name, store):
            yield from _remove([info.key for info in infos], before, objects, seen)
    yield


def is_upload(name: str, store: UploadStore[Any]) -> bool:
    """Whether the record knows the model or the file of clips with this hash."""
    try:
        store.find(f"sha256:{name}")
    except NotFound:
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


def end_unfinished(*, store: JobStore, objects: ObjectStore, grace: timedelta = GRACE) -> int:
    """Remove what such uploads left; returns how many there were. Raises RecordsUnavailable.

    A store that refuses is only logged: the service does not need this, and its key may lack the right.
    """
    before = store.now() - grace
    try:
        ended = sum(objects.end_uploads(prefix, before) for prefix in keys.folders())
    except StorageUnavailable as error:
        log.warning(
            "unfinished_uploads_kept",
            error=error.detail,
            remedy="a lifecycle rule of the bucket with AbortIncompleteMultipartUpload removes them, too",
        )
        return 0
    if ended:
        log.info("unfinished_uploads_ended", num_uploads=ended)
    return ended


_PAGE = 200


@dataclass(frozen=True)
class Difference:
    """Where the record and the bucket disagree about a job, or a file that users sent, by its id.

    missing: keys of objects that the record names and the bucket lacks. unknown: keys that no record names;
    beside a running service, files that it is about to name are among them.
    """

    owner: str
    missing: Sequence[str]
    unknown: Sequence[str]


def differences(*, store: JobStore, objects: ObjectStore) -> Iterator[Difference]:
    """Every difference. Raises RecordsUnavailable, StorageUnavailable."""
    seen = set(store.deletions())  # The reconciler removes the rest of these.
    for batch in batches(folders(objects.list(keys.jobs()))):
        yield from _differences_in_jobs({name: batch[name] for name in batch.keys() - seen}, store, objects)
        seen |= batch.keys()
    cursor: str | None = ""
    while cursor is not None:
        page = store.list(JobQuery(), cursor=cursor or None, limit=_PAGE, brief=True)
        yield from _differences_in_jobs(
            {job.id: () for job in page.jobs if job.id not in seen}, store, objects
        )
        cursor = page.next_cursor
    for uploads in (store.models, store.clips):
        yield from _differences_in_uploads(uploads, objects)


def mark_missing(owner: str, missing: Sequence[str], *, store: JobStore, objects: ObjectStore) -> None:
    """Remove from the record what is missing: files, with a note in the job's events; a model or clips,
    so that they can be sent again. Clips that are there as they were sent are validated again instead, which
    makes the rest. A note takes the place of a missing part of a feed.

    Raises JobNotFound, JobUnreadable.
    """
    if owner.startswith("sha256:"):
        for uploads in (store.models, store.clips):  # No two have an id in common.
            _mark_upload(owner, missing, uploads)
        return
    for chunk in store.chunks([owner]).get(owner, ()):
        if chunk.key in missing:
            feeds.close_gap(owner, chunk, store=store, objects=objects)
    while True:
        job = store.get(owner)
        lost = [artifact for artifact in job.artifacts if artifact.key in missing]
        if not lost:
            return
        names = ", ".join(artifact.name for artifact in lost)
        note = f"Lost from the object store, and removed from the record: {names}."
        with suppress(StaleJob):  # Its attempt came between; look again.
            store.save(job.without_artifacts(lost), note=note)


def _mark_upload(upload_id: str, missing: Sequence[str], store: UploadStore[Any]) -> None:
    if store.kind.source(upload_id) in missing:
        store.delete(upload_id)
        return
    with suppress(NotFound):
        record = store.find(upload_id)
        # With its description: jobs that name it go on where they find what they need.
        store.settle(record.model_copy(update={"status": "validating"}))


def _differences_in_jobs(batch: Folders, store: JobStore, objects: ObjectStore) -> Iterator[Difference]:
    """The batch was listed before the record is read here."""
    known = store.marks(batch)
    named, found = set(store.objects_named(known)), {info.key for infos in batch.values() for info in infos}
    # A file may have been named after the listing; and one that was listed nowhere may have been dropped.
    if gone := {key for key in named - found if not _exists(key, objects)}:
        gone &= set(store.objects_named(known))
    missing, unknown = defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    for key in sorted(gone):
        missing[keys.job_of(key)].append(key)
    for key in sorted(found - named):
        unknown[keys.job_of(key)].append(key)
    for job_id in sorted(missing.keys() | unknown.keys()):
        yield Difference(job_id, missing[job_id], unknown[job_id])


def _differences_in_uploads(store: UploadStore[Any], objects: ObjectStore) -> Iterator[Difference]:
    known = {record.id: record for record in store.all() if record.status != "refused"}
    for name, infos in folders(objects.list(store.kind.folder)):
        if f"sha256:{name}" not in known and not is_upload(name, store):
            yield Difference(f"sha256:{name}", (), [info.key for info in infos])
    for upload_id, record in known.items():
        needed = [store.kind.source(upload_id), *store.kind.made(record)]
        missing = [key for key in needed if not _exists(key, objects)]
        if missing and is_upload(upload_id.removeprefix("sha256:"), store):
            yield Difference(upload_id, missing, ())


def _exists(key: str, objects: ObjectStore) -> bool:
    try:
        objects.info(key)
    except ObjectNotFound:
        return False
    return True
