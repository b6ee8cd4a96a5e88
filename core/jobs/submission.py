"""From a specification to a queued job."""

import structlog

from core.errors import GaitwayError, RecordsUnavailable
from core.jobs.checks import check
from core.jobs.job import Job, new_job_id
from core.jobs.queue import JobQueue
from core.jobs.spec import JobSpec
from core.jobs.store import Dispatch, Idempotency, JobStore

log = structlog.get_logger()


def submit(
    spec: JobSpec,
    *,
    store: JobStore,
    queue: JobQueue,
    idempotency: Idempotency | None = None,
) -> Job:
    """The queued job; or the one an earlier submission under the same key made.

    The job and its dispatch are one transaction: from the answer on, no loss of Redis loses the job.
    Raises Rejected, IdempotencyKeyReused, RecordsUnavailable.
    """
    if idempotency is not None and (known := store.remembered(idempotency)) is not None:
        return known
    check(spec, store)
    now = store.now()
    job = store.add(Job(id=new_job_id(now), spec=spec, created_at=now), idempotency)
    hand_over(Dispatch("attempt", job.id, job.next_attempt), store=store, queue=queue, job=job)
    return job


def hand_over(dispatch: Dispatch, *, store: JobStore, queue: JobQueue, job: Job | None = None) -> bool:
    """Tell the workers' queue; whether it heard. If it is away or fails, the reconciler tells it later.

    job: what the dispatch is of, for whoever has just stored it.
    """
    try:
        if dispatch.task == "model":
            queue.enqueue_model(dispatch.subject)
        else:
            _enqueue(job or store.get(dispatch.subject), queue)
        store.dispatched(dispatch)
    except RecordsUnavailable as error:
        log.warning("dispatch_postponed", subject=dispatch.subject, error=error.detail)
        return False
    except GaitwayError:
        raise
    except Exception:
        # The queue's own. The record has the job: whoever sent it is not told that it failed.
        log.exception("dispatch_failed", subject=dispatch.subject)
        return False
    return True


def _enqueue(job: Job, queue: JobQueue) -> None:
    queue.enqueue(
        job.id,
        job.next_attempt,
        accelerator=job.accelerator,
        priority=job.spec.priority,
        gpus=job.spec.resources.gpus,
    )
