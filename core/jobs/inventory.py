"""Compares the record with the bucket: what the bucket lacks, and what no record names."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

from core.errors import ObjectNotFound, StaleJob
from core.jobs import feeds
from core.jobs.orphans import Folders, batches, columns_of, folders, is_model
from core.jobs.store import JobQuery, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

_PAGE = 200


@dataclass(frozen=True)
class Difference:
    """Where the record and the bucket disagree about a job or a user's own model, by its id.

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
        yield from _of_jobs({name: batch[name] for name in batch.keys() - seen}, store, objects)
        seen |= batch.keys()
    cursor: str | None = ""
    while cursor is not None:
        page = store.list(JobQuery(), cursor=cursor or None, limit=_PAGE, brief=True)
        yield from _of_jobs({job.id: () for job in page.jobs if job.id not in seen}, store, objects)
        cursor = page.next_cursor
    yield from _of_models(store, objects)


def mark_missing(owner: str, missing: Sequence[str], *, store: JobStore, objects: ObjectStore) -> None:
    """Remove from the record what is missing: files, with a note in the job's events; a model, so that it can
    be sent again. A note takes the place of a missing part of a feed.

    Raises JobNotFound, JobUnreadable.
    """
    if owner.startswith("sha256:"):
        store.delete_model(owner)
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


def _of_jobs(batch: Folders, store: JobStore, objects: ObjectStore) -> Iterator[Difference]:
    """The batch was listed before the record is read here."""
    known = store.marks(batch)
    named, found = set(store.objects_named(known)), {info.key for infos in batch.values() for info in infos}
    # A file may have been named after the listing; and one that was listed nowhere may have been dropped.
    if gone := {key for key in named - found if not _exists(key, objects)}:
        gone &= set(store.objects_named(known))
    missing, unknown = defaultdict[str, list[str]](list), defaultdict[str, list[str]](list)
    for key in sorted(gone):
        missing[keys.job_of(key)].append(key)
    for key in sorted(found - named - columns_of(known, store)):
        unknown[keys.job_of(key)].append(key)
    for job_id in sorted(missing.keys() | unknown.keys()):
        yield Difference(job_id, missing[job_id], unknown[job_id])


def _of_models(store: JobStore, objects: ObjectStore) -> Iterator[Difference]:
    known = {record.id for record in store.models() if record.status != "refused"}
    for name, infos in folders(objects.list(keys.models())):
        if f"sha256:{name}" not in known and not is_model(name, store):
            yield Difference(f"sha256:{name}", (), [info.key for info in infos])
    for model_id in sorted(known):
        source = keys.model_source(model_id)
        if not _exists(source, objects) and is_model(model_id.removeprefix("sha256:"), store):
            yield Difference(model_id, [source], ())


def _exists(key: str, objects: ObjectStore) -> bool:
    try:
        objects.info(key)
    except ObjectNotFound:
        return False
    return True
