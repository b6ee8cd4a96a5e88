"""The end a user asks for."""

from core.errors import JobFinished, RecordsUnavailable, StaleJob
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.status import JobStatus, Reason
from core.jobs.store import JobStore


def cancel(job_id: str, *, store: JobStore, queue: JobQueue) -> Job:
    """The job, cancelled if it waited, `cancelling` while its worker saves what there is.

    Cancelling twice is the same as once. Raises JobNotFound, JobUnreadable; JobFinished where the job ended
    otherwise.
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
                return _end(job, store, queue)
            store.save(cancelling := job.become(JobStatus.CANCELLING))
        except StaleJob:
            continue
        return cancelling


_ENDED = {JobStatus.SUCCEEDED: "succeeded", JobStatus.FAILED: "failed"}


def _end(job: Job, store: JobStore, queue: JobQueue) -> Job:
    message = "Cancelled while it was queued."
    ended = job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, message, store.now())
    store.save(ended)
    forget_dispatch(job, queue)
    return ended


def forget_dispatch(job: Job, queue: JobQueue) -> None:
    """Take the next attempt out of the queue, if it can be reached: no worker could claim it any more."""
    try:
        queue.remove(job.id, job.next_attempt)
    except RecordsUnavailable:
        return
