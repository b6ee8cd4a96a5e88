"""Which jobs can train together on one device: those that differ only in numbers that need no compiling.

Trials of one sweep do (`core.algorithms.cohort` trains them); other jobs keep their places in the queue.
"""

import sys
from collections.abc import Sequence
from typing import Any

from core.algorithms.catalog import resolve
from core.environments import catalog
from core.environments.info import Device
from core.errors import GaitwayError
from core.jobs.job import Job
from core.jobs.needs import memory_for
from core.jobs.own_model import model_of
from core.jobs.spec import TrainSpec
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery, JobStore
from core.jobs.waiting import fitting
from core.jobs.workers import WorkerInfo

# The label that a sweep's trials share.
SWEEP = "sweep"
# Of the device's memory, for what the runs certainly need. That is a fifth of what a run takes (measured for
# four bodies), and JAX takes three quarters of a GPU's memory for itself.
_SHARE_OF_MEMORY = 0.15


def companions(
    job: Job,
    store: JobStore,
    device: Device,
    here: WorkerInfo | None,
    workers: Sequence[WorkerInfo],
    at_most: int,
) -> Sequence[Job]:
    """Queued trials of the queued job's sweep that can train together with it, oldest first.

    device: the kind that this worker has. here: this worker, as far as it is known; workers: all. at_most:
    how many may be returned; the device's memory, or free workers, may leave fewer for this one.
    """
    sweep, shape = job.spec.labels.get(SWEEP), shape_of(job, device)
    if sweep is None or shape is None or at_most < 1:
        return []
    queued = store.list(JobQuery(status=JobStatus.QUEUED, labels={SWEEP: sweep}), limit=100).jobs
    found = [
        one
        for one in reversed(queued)
        if isinstance(one, Job) and one.id != job.id and shape_of(one, device) == shape
    ]
    free = [worker for worker in fitting(job, workers) if _is_free(worker, here)]
    share = -(-(len(found) + 1) // (len(free) + 1))
    return found[: min(at_most, share - 1, _room(job, device, here) - 1)]


def shape_of(job: Job, device: Device) -> dict[str, Any] | None:
    """A key that is equal for jobs that can train together; None for a job that trains alone.

    A job trains alone if it was begun before, resumes from another job's checkpoint, asks for several GPUs or
    has a user's own model, or if its algorithm takes no numbers as arguments.
    """
    spec = job.spec
    if not isinstance(spec, TrainSpec) or not spec.algorithm.arguments:
        return None
    begun = job.next_attempt > 1 or spec.source is not None
    if begun or spec.resources.gpus > 1 or model_of(spec.environment) is not None:
        return None
    try:
        info, _ = catalog.resolve(spec.environment.id, spec.environment.options)
        settings = resolve(spec.algorithm, info, device)
    except GaitwayError:  # Its attempt says what is wrong.
        return None
    numbers = {name: getattr(settings, name) is None for name in settings.arguments}
    own = spec.model_dump(mode="json", exclude={"seed", "name", "labels", "algorithm"})
    return {**own, "algorithm": {**settings.model_dump(mode="json"), **numbers}}


def _is_free(worker: WorkerInfo, here: WorkerInfo | None) -> bool:
    return worker.job is None and worker.state == "ready" and (here is None or worker.name != here.name)


def _room(job: Job, device: Device, here: WorkerInfo | None) -> int:
    """How many such jobs fit into this worker's device; unbounded where its memory is not known."""
    needed = memory_for(job.spec).get(device)
    if here is None or here.memory_bytes is None or needed is None or not needed.bytes:
        return sys.maxsize
    return max(1, int(_SHARE_OF_MEMORY * here.memory_bytes) // needed.bytes)
