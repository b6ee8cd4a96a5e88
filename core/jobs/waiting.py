"""Why a queued job may wait for ever, or fail when it is taken: no present worker can serve it."""

from collections.abc import Mapping, Sequence

from core.algorithms.memory import Memory
from core.environments.info import Device
from core.jobs.job import Job
from core.jobs.needs import EXTRAS, kind_of, memory_for, packages_for
from core.jobs.queue import queue_name
from core.jobs.status import JobStatus
from core.jobs.store import WorkerInfo


def what_it_waits_for(job: Job, workers: Sequence[WorkerInfo]) -> str | None:
    """A sentence where no worker that is there could serve the job; None where one could, or it runs.

    A worker that does not say what it has may have all that it takes.
    """
    if job.status != JobStatus.QUEUED:
        return None
    gpus = job.spec.resources.gpus
    queue = queue_name(job.accelerator, job.spec.priority, gpus)
    fitting = [worker for worker in workers if queue in worker.queues]
    if not fitting:
        here = sorted({worker.device for worker in workers})
        there = f"the workers here have {', '.join(here)}" if here else "no worker is there at all"
        return f"No worker with {_needed(job, gpus)} is there: {there}."
    able = [worker for worker in fitting if worker.state != "device_failed"]
    if not able:
        return "The device of each worker that fits was set aside: " + " ".join(
            f"{worker.name}: {worker.problem}" for worker in fitting
        )
    packages, memory = packages_for(job), memory_for(job.spec)
    equipped = [worker for worker in able if not _lacks(worker, packages)]
    if not equipped:
        return _no_package(able, packages)
    if not any(_has_memory(worker, memory) for worker in equipped):
        return _too_large(equipped, memory)
    return None


def _needed(job: Job, gpus: int) -> str:
    if gpus > 1:
        return f"exactly {gpus} GPUs"
    return {"gpu": "a GPU to itself", "cpu": "a CPU", "any": "one GPU or a CPU"}[job.accelerator]


def _lacks(worker: WorkerInfo, packages: Mapping[str, str]) -> list[str]:
    return [] if worker.packages is None else [name for name in packages if name not in worker.packages]


def _no_package(workers: Sequence[WorkerInfo], packages: Mapping[str, str]) -> str:
    """About the worker that lacks the fewest packages."""
    missing = min((_lacks(worker, packages) for worker in workers), key=len)
    parts = [f"{packages[name]} (pip install 'gaitway[{EXTRAS[name]}]')" for name in missing]
    return f"No worker here that fits can run {' and '.join(parts)}: install it there, or ask for another."


def _has_memory(worker: WorkerInfo, memory: Mapping[Device, Memory]) -> bool:
    need = memory.get(kind_of(worker.device))
    return need is None or worker.memory_bytes is None or need.bytes <= worker.memory_bytes


def _too_large(workers: Sequence[WorkerInfo], memory: Mapping[Device, Memory]) -> str:
    largest = max(workers, key=lambda worker: worker.memory_bytes or 0)
    size, device = largest.memory_bytes or 0, kind_of(largest.device)
    return memory[device].does_not_fit(size, f"the largest {device.upper()} of a worker")
