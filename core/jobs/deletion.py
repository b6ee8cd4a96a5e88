"""Forgetting a job for good."""

from core.errors import JobNotFinished
from core.jobs.queue import JobQueue
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore


def delete(job_id: str, *, store: JobStore, queue: JobQueue, objects: ObjectStore) -> None:
    """Remove the files first and the record last, so that a deletion cut short can be asked for again.

    Raises JobNotFound, and JobNotFinished unless the job has ended.
    """
    job = store.get(job_id)
    if not job.status.is_final:
        raise JobNotFinished(f"Job {job_id} is {job.status}; cancel it first.", job=job_id, status=job.status)
    objects.delete_prefix(keys.job(job_id))
    queue.remove(job_id, job.next_attempt)
    store.delete(job)
