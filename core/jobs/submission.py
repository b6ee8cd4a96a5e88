"""From a specification to a queued job."""

from collections.abc import Callable

import structlog

from core.algorithms.catalog import environment_options
from core.errors import GaitwayError, JobNotFound, JobUnreadable, Problem, RecordsUnavailable, Rejected
from core.jobs.checks import check
from core.jobs.job import Job, new_job_id
from core.jobs.queue import MOST_SUBMITTED, JobQueue, queue_of
from core.jobs.spec import CheckpointPolicy, JobSpec, RolloutSpec, TrainSpec
from core.jobs.store import Dispatch, Idempotency, JobStore

log = structlog.get_logger()


def submit(
    spec: JobSpec,
    *,
    store: JobStore,
    queue: JobQueue,
    idempotency: Idempotency | None = None,
    acknowledge: Callable[[Dispatch], None] = lambda dispatch: None,
) -> Job:
    """Store and queue a job; or return the one that an earlier submission with the same key created.

    The job and its dispatch are stored in one transaction: after that, a loss of Redis cannot lose the job.
    acknowledge: called with the dispatch once the queue has received it; without, the reconciler finds out.
    Raises Rejected, IdempotencyKeyReused, RecordsUnavailable.
    """
    if idempotency is not None and (known := store.remembered(idempotency)) is not None:
        return known
    try:
        job = store.add(new_job(spec, store), idempotency)
    except JobNotFound:  # The job whose checkpoint it needs was deleted between the check and this.
        job = store.add(new_job(spec, store), idempotency)
    dispatch = Dispatch("attempt", job.id, job.next_attempt)
    if hand_over_if_room(dispatch, job, queue):
        acknowledge(dispatch)
    return job


def new_job(spec: JobSpec, store: JobStore) -> Job:
    """The job of a submission, checked and not stored yet. Raises Rejected."""
    spec = completed(with_environment(spec, store))
    check(spec, store)
    now = store.now()
    return Job(id=new_job_id(now), spec=spec, created_at=now)


def completed(spec: JobSpec) -> JobSpec:
    """The specification with those options of its environment that its algorithm is tuned for.

    They are stored, so that everything that reads the job later sees the environment that it was trained in.
    """
    if not isinstance(spec, TrainSpec):
        return spec
    environment = spec.environment
    if not (taken := environment_options(spec.algorithm, environment.id, environment.options)):
        return spec
    options = {**environment.options, **taken}
    return spec.model_copy(update={"environment": environment.model_copy(update={"options": options})})


def with_environment(spec: JobSpec, store: JobStore) -> JobSpec:
    """The specification; a rollout without an environment gets that of its policy's job. Raises Rejected."""
    if not isinstance(spec, RolloutSpec) or "environment" in spec.model_fields_set:
        return spec
    if not isinstance(spec.policy, CheckpointPolicy):
        detail = "`environment` is missing; only a rollout of a checkpoint may leave it out."
        raise Rejected(detail, [Problem("/environment", detail)])
    try:
        source = store.get(spec.policy.job)
    except (JobNotFound, JobUnreadable) as error:
        raise Rejected(error.detail, [Problem("/policy/job", error.detail)]) from None
    return spec.model_copy(update={"environment": source.spec.environment})


def hand_over_if_room(dispatch: Dispatch, job: Job, queue: JobQueue) -> bool:
    """`hand_over` for a new job; where many wait already, the reconciler does it when their turn has come."""
    name = queue_of(job)
    try:
        if queue.num_waiting([name])[name] >= MOST_SUBMITTED:
            return False
    except RecordsUnavailable as error:
        log.warning("dispatch_postponed", subject=dispatch.subject, error=error.detail)
        return False
    return hand_over(dispatch, queue=queue, job=job)


def hand_over(dispatch: Dispatch, *, queue: JobQueue, job: Job | None = None) -> bool:
    """Put the dispatch into the workers' queue; returns whether that worked. If not, the reconciler retries.

    job: the job of an attempt.
    """
    try:
        if job is None:
            queue.enqueue_model(dispatch.subject)
        else:
            _enqueue(job, queue)
    except RecordsUnavailable as error:
        log.warning("dispatch_postponed", subject=dispatch.subject, error=error.detail)
        return False
    except GaitwayError:
        raise
    except Exception:
        # Such as a refusal by Redis that its adapter does not know. The record has the job: the client must
        # not be told that the submission failed.
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
