"""Why a queued job may wait for ever: nobody is there who could take it."""

from collections.abc import Sequence

from core.jobs.job import Job
from core.jobs.queue import queue_name
from core.jobs.status import JobStatus
from core.jobs.store import WorkerInfo


def what_it_waits_for(job: Job, workers: Sequence[WorkerInfo]) -> str | None:
    """A sentence where no worker that is there could take the job; None where one could, or it runs."""
    if job.status != JobStatus.QUEUED:
        return None
    gpus = job.spec.resources.gpus
    queue = queue_name(job.accelerator, job.spec.priority, gpus)
    fitting = [worker for worker in workers if queue in worker.queues]
    if any(worker.state != "device_failed" for worker in fitting):
        return None
    if fitting:
        return "The device of each worker that fits was set aside: " + " ".join(
            f"{worker.name}: {worker.problem}" for worker in fitting
        )
    here = sorted({worker.device for worker in workers})
    there = f"the workers here have {', '.join(here)}" if here else "no worker is there at all"
    return f"No worker with {_needed(job, gpus)} is there: {there}."


def _needed(job: Job, gpus: int) -> str:
    if gpus > 1:
        return f"exactly {gpus} GPUs"
    return {"gpu": "a GPU to itself", "cpu": "a CPU", "any": "one GPU or a CPU"}[job.accelerator]
