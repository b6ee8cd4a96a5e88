"""From a specification to a queued job."""

from datetime import datetime

import structlog

from core.errors import JobExists, RecordsUnavailable
from core.jobs.checks import check
from core.jobs.job import Job, new_job_id
from core.jobs.queue import JobQueue
from core.jobs.spec import JobSpec
from core.jobs.store import Idempotency, JobStore
from core.storage import keys
from core.storage.objects import ObjectStore

log = structlog.get_logger()


def submit(
    spec: JobSpec,
    *,
    store: JobStore,
    queue: JobQueue,
    objects: ObjectStore,
    now: datetime,
    idempotency: Idempotency | None = None,
) -> Job:
    """The queued job; or the one an earlier submission under the same key made.

    The specification is in the object store before the record is, and the record before the dispatch:
    from the answer on, neither an emptied Redis nor a forgetful queue loses the job.
    Raises Rejected, IdempotencyKeyReused, StorageUnavailable, RecordsUnavailable.
    """
    if idempotency is not None and (known := store.remembered(idempotency)) is not None:
        return known
    check(spec, store, objects)
    job = Job(id=new_job_id(now), spec=spec, created_at=now)
    objects.put(keys.spec(job.id), job.model_dump_json().encode(), media_type="application/json")
    try:
        stored = store.add(job, idempotency)
    except JobExists:  # The reconciler restored it from the specification just written.
        stored = store.get(job.id)
    except Exception:
        objects.delete_prefix(keys.job(job.id))
        raise
    if stored.id != job.id:  # Another request with the same key was faster.
        objects.delete_prefix(keys.job(job.id))
        return stored
    dispatch(stored, queue)
    return stored


def dispatch(job: Job, queue: JobQueue) -> None:
    """Hand a queued job to the workers. A queue that is away is no failure: the reconciler asks again."""
    try:
        queue.enqueue(
            job.id,
            job.next_attempt,
            accelerator=job.accelerator,
            priority=job.spec.priority,
            gpus=job.spec.resources.gpus,
        )
    except RecordsUnavailable as error:
        log.warning("dispatch_postponed", job_id=job.id, error=error.detail)
