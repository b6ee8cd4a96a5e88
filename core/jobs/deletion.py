"""Deletes a job permanently."""

from contextlib import suppress

from core.errors import JobInUse, JobNotFinished, StorageUnavailable
from core.jobs.store import JobStore
from core.storage import keys
from core.storage.objects import ObjectStore


def delete(job_id: str, *, store: JobStore, objects: ObjectStore) -> None:
    """Remove the files first and the record last, so that an interrupted deletion can be repeated.

    A record that cannot be read can be deleted. Raises JobNotFound; JobNotFinished unless the job has ended;
    JobInUse while another one needs a checkpoint of it.
    """
    job = store.find(job_id)
    if not job.status.is_final:
        raise JobNotFinished(f"Job {job_id} is {job.status}; cancel it first.", job=job_id, status=job.status)
    if borrowers := [borrower for borrower, _ in store.borrowers_of(job_id)]:
        raise JobInUse(job_id, borrowers)
    objects.delete_prefix(keys.job(job_id))
    store.delete(job_id, job.version)
    with suppress(StorageUnavailable):  # It may have been copied again in between.
        objects.delete_prefix(keys.record(job_id))
