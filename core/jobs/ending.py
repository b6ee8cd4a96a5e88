"""Cancels a job; deletes a job, or a file that users sent, permanently."""

from collections.abc import Collection, Iterable
from contextlib import suppress
from datetime import datetime, timedelta

from core.errors import (
    JobFinished,
    JobNotFinished,
    RecordsUnavailable,
    StaleJob,
    StorageUnavailable,
)
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore
from core.uploads import library
from core.uploads.record import Record, UploadStore


def cancel(job_id: str, *, store: JobStore, queue: JobQueue) -> Job:
    """Cancel a queued job at once; a running one is `cancelling` until its worker has saved its results.

    Cancelling twice changes nothing. Raises JobNotFound, JobUnreadable; JobFinished if the job has succeeded
    or failed.
    """
    job = cancel_in_record(job_id, store=store)
    if job.status == JobStatus.CANCELLED:
        forget_dispatches([job], queue)
    return job


def cancel_in_record(job_id: str, *, store: JobStore) -> Job:
    """`cancel`, of which the queue is not told. Raises as that does."""
    while True:
        job = store.get(job_id)
        if job.status in (JobStatus.CANCELLING, JobStatus.CANCELLED):
            return job
        if job.status.is_final:
            raise JobFinished(
                f"Job {job_id} has already {_ENDED[job.status]}; there is nothing to cancel.", job=job_id
            )
        try:
            store.save(changed := _stopped(job, store.now()))
        except StaleJob:
            continue
        return changed


_ENDED = {JobStatus.SUCCEEDED: "succeeded", JobStatus.FAILED: "failed"}


def _stopped(job: Job, now: datetime) -> Job:
    if job.status != JobStatus.QUEUED:
        return job.become(JobStatus.CANCELLING)
    return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "Cancelled while it was queued.", now)


def forget_dispatches(jobs: Iterable[Job], queue: JobQueue) -> None:
    """Remove the next attempts from the queue, if that answers: no worker could claim them any more."""
    with suppress(RecordsUnavailable):
        for job in jobs:
            queue.remove(job.id, job.next_attempt)


# Another process may be writing a part of a feed just now: by then it has finished.
_OBJECTS_AGAIN_AFTER = timedelta(minutes=2)


def delete(job_id: str, *, store: JobStore, objects: ObjectStore) -> None:
    """Remove the record first, so that nobody is shown a job whose files are gone, and then the files.

    `end_deletions` removes the files that an outage of the object store leaves. A record that cannot be read
    can be deleted. Raises JobNotFound; JobNotFinished unless the job has ended; JobInUse while another one
    needs a checkpoint of it, or a sweep is to make jobs that do.
    """
    delete_in_record(job_id, store=store)
    with suppress(StorageUnavailable):
        objects.delete_prefix(keys.job(job_id))


def delete_in_record(job_id: str, *, store: JobStore) -> None:
    """`delete`, of which `end_deletions` removes the files. Raises as that does."""
    job = store.find(job_id)
    if not job.status.is_final:
        raise JobNotFinished(f"Job {job_id} is {job.status}; cancel it first.", job=job_id, status=job.status)
    store.delete(job_id, job.version)


def end_deletions(*, store: JobStore, objects: ObjectStore, after: timedelta = _OBJECTS_AGAIN_AFTER) -> int:
    """Remove what is left of jobs that were deleted so long ago; returns how many.

    Raises RecordsUnavailable, StorageUnavailable.
    """
    deleted = store.deletions(before=after)
    for job_id in deleted:
        objects.delete_prefix(keys.job(job_id))
        store.deletion_ended(job_id)
    return len(deleted)


def remove_upload(
    upload_id: str,
    uploads: UploadStore[Record],
    projects: Collection[str],
    *,
    objects: ObjectStore,
) -> None:
    """Take a model or a file of clips from these projects; once none has it, remove its record and its file.

    The record goes first: no job names a file that is gone. If the file is sent again in between, its
    validation says that it is to be sent once more. Raises the kind's `missing`, and its `in_use` while a job
    or sweep in one of these projects needs it. Ended jobs keep their files, but their policies cannot be run
    here any more.
    """
    library.find(upload_id, uploads)
    if uploads.release(upload_id, projects):
        objects.delete_prefix(keys.previews_of(upload_id))
        objects.delete_prefix(uploads.kind.prefix(upload_id))
