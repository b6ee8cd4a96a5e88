"""The end a user asks for."""

from datetime import datetime

from core.errors import JobFinished, StaleJob
from core.jobs.durability import keep_record
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.status import JobStatus, Reason
from core.jobs.store import JobStore
from core.storage.objects import ObjectStore


def cancel(job_id: str, *, store: JobStore, queue: JobQueue, objects: ObjectStore, now: datetime) -> Job:
    """The job, cancelled if it waited, `cancelling` while its worker saves what there is.

    Cancelling twice is the same as once. Raises JobNotFound; JobFinished where the job ended otherwise.
    """
    while True:
        job = store.get(job_id)
        if job.status in (JobStatus.CANCELLING, JobStatus.CANCELLED):
            return job
        if job.status.is_final:
            raise JobFinished(
                f"Job {job_id} has already {_ENDED[job.status]}; there is nothing to cancel.", job=job_id
            )
        try:
            if job.status == JobStatus.QUEUED:
                return _end(job, store, queue, objects, now)
            store.save(cancelling := job.become(JobStatus.CANCELLING))
        except StaleJob:
            continue
        return cancelling


_ENDED = {JobStatus.SUCCEEDED: "succeeded", JobStatus.FAILED: "failed"}


def _end(job: Job, store: JobStore, queue: JobQueue, objects: ObjectStore, now: datetime) -> Job:
    message = "Cancelled while it was queued."
    ended = job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, message, now)
    store.save(ended)
    queue.remove(job.id, job.next_attempt)
    keep_record(ended, objects)
    return ended
