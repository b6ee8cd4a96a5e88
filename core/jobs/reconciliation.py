"""Setting right what crashes left behind. Idempotent, and safe to run in many places at once."""

from datetime import datetime, timedelta

import structlog

from core.errors import JobNotFound, StaleJob
from core.jobs.attempts import given_back
from core.jobs.durability import keep_record, restore
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.status import JobStatus, Reason
from core.jobs.store import JobStore
from core.jobs.submission import dispatch
from core.storage.objects import ObjectStore

log = structlog.get_logger()


def reconcile(
    *, store: JobStore, queue: JobQueue, objects: ObjectStore, lease: timedelta, now: datetime
) -> int:
    """One look over every unfinished job; how many were set right.

    A queued job that no queue knows is dispatched again; a held job whose lease has run out is taken
    back from its worker; an empty store is rebuilt from the bucket.
    """
    mended = restore(store, objects, now)
    for job in store.unfinished():
        try:
            mended += _mend(job, store, queue, objects, lease, now)
        except (StaleJob, JobNotFound):  # Somebody else moved it: then it needs no mending.
            continue
    return mended


def _mend(
    job: Job, store: JobStore, queue: JobQueue, objects: ObjectStore, lease: timedelta, now: datetime
) -> bool:
    if job.status == JobStatus.QUEUED:
        if queue.contains(job.id, job.next_attempt):
            return False
        log.info("job_dispatched_again", job_id=job.id, attempt=job.next_attempt)
        dispatch(job, queue)
        return True
    if store.lease_is_alive(job.id) or now - job.attempts[-1].started_at < lease:
        return False
    worker = job.attempts[-1].worker
    message = f"Worker {worker} has been silent for longer than its lease of {lease.total_seconds():g} s."
    taken = given_back(job, Reason.WORKER_LOST, message, now)
    store.save(taken)
    keep_record(taken, objects)
    log.warning("job_taken_back", job_id=job.id, worker=worker, status=taken.status)
    if taken.status == JobStatus.QUEUED:
        dispatch(taken, queue)
    return True
