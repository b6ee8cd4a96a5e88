"""A run of another service becomes an ended job of this one: its files are stored first, its record last."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import IO

from core.errors import BadExport, JobUnreadable, RecordsUnavailable, Rejected, StorageUnavailable
from core.jobs.job import Artifact, Job
from core.jobs.store import Entry, Idempotency, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore


@dataclass(frozen=True)
class ImportedFile:
    """A file of the run. open: its bytes, which have the artifact's hash."""

    artifact: Artifact
    open: Callable[[], AbstractContextManager[IO[bytes]]]


@dataclass(frozen=True)
class Run:
    """A run under its new id. events, logs: its feeds; each may be read several times."""

    job: Job
    files: Sequence[ImportedFile]
    events: Iterable[Entry]
    logs: Iterable[Entry]


def import_run(
    run: Run, *, store: JobStore, objects: ObjectStore, idempotency: Idempotency | None = None
) -> Job:
    """Store the run; or return the job that an earlier import with the same key created.

    Of a run that is refused, nothing is left. Files that cannot be removed, because a process or a store has
    failed, are removed by the sweep of orphans (`core.jobs.orphans`).
    Raises BadExport, IdempotencyKeyReused, RecordsUnavailable, StorageUnavailable.
    """
    try:
        for file in run.files:
            artifact = file.artifact
            with file.open() as stream:
                _put(artifact, stream, objects)
        job = _record(run, store, idempotency)
    except RecordsUnavailable:  # The record may be stored, and only the answer lost.
        raise
    except Exception:
        _remove_files(run, objects)
        raise
    if job is not run.job:
        _remove_files(run, objects)
    return job


def _put(artifact: Artifact, stream: IO[bytes], objects: ObjectStore) -> None:
    try:
        objects.put_stream(artifact.key, stream, artifact.size, media_type=artifact.media_type)
    except Rejected as error:
        raise BadExport(f"The file {artifact.name[:100]!r} cannot be stored: {error.detail}") from error


def _record(run: Run, store: JobStore, idempotency: Idempotency | None) -> Job:
    """The job once it is stored, or the one that another import with this key has stored meanwhile."""
    try:
        while not store.import_job(run.job, run.events, run.logs, idempotency=idempotency):
            # None if that job was deleted just now, and its key with it.
            if idempotency is not None and (known := store.remembered(idempotency)) is not None:
                return known
    except JobUnreadable as error:
        raise BadExport(f"The record of the job cannot be stored: {error.problem}.") from error
    return run.job


def _remove_files(run: Run, objects: ObjectStore) -> None:
    with suppress(StorageUnavailable):
        objects.delete_prefix(keys.job(run.job.id))
