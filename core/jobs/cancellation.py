"""Cancels a job."""

from core.errors import JobFinished, RecordsUnavailable, StaleJob
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason


def cancel(job_id: str, *, store: JobStore, queue: JobQueue) -> Job:
    """Cancel a queued job at once; a running one is `cancelling` until its worker has saved its results.

    Cancelling twice changes nothing. Raises JobNotFound, JobUnreadable; JobFinished if the job has succeeded
    or failed.
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
    """Remove the next attempt from the queue, if that can be reached: no worker could claim it any more."""
    try:
        queue.remove(job.id, job.next_attempt)
    except RecordsUnavailable:
        return
