"""The present workers that can run a queued job, and the reason if there is none."""

from collections.abc import Collection, Mapping, Sequence

from core.algorithms.memory import Memory
from core.environments.info import Device
from core.jobs.job import Job
from core.jobs.needs import how_to_install, kind_of, memory_for, packages_for
from core.jobs.queue import queue_name
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo


def what_it_waits_for(job: Job, workers: Sequence[WorkerInfo]) -> str | None:
    """A sentence if no present worker could run the job; None if one could, or the job is not queued.

    A worker that does not report its packages or memory may have enough.
    """
    if job.status != JobStatus.QUEUED:
        return None
    suitable = fitting(job, workers)
    if not suitable:
        here = sorted({worker.device for worker in workers})
        there = f"the workers here have {', '.join(here)}" if here else "no worker is running"
        return f"No worker has {_needed(job, job.spec.resources.gpus)}: {there}."
    able = _with_device(suitable)
    if not able:
        return "The device of each suitable worker was set aside: " + " ".join(
            f"{worker.name}: {worker.problem}" for worker in suitable
        )
    packages, memory = packages_for(job), memory_for(job.spec)
    equipped = [worker for worker in able if not _missing(worker.packages, packages)]
    if not equipped:
        return _no_package(able, packages)
    if not any(_has_memory(worker, memory) for worker in equipped):
        return _too_large(equipped, memory)
    return None


def why_left_to_others(job: Job, has: Collection[str], workers: Sequence[WorkerInfo]) -> str | None:
    """A sentence if this worker lacks a package that a queued job needs, and another worker lacks none.

    None if it lacks nothing, or if no other worker reports all of them: the attempt then fails, and names the
    extra. has: this worker's packages. Memory is not compared.
    """
    packages = packages_for(job)
    missing = _missing(has, packages)
    if job.status != JobStatus.QUEUED or not missing:
        return None
    for worker in _with_device(fitting(job, workers)):
        if worker.packages is not None and not _missing(worker.packages, packages):
            return f"This worker cannot run {_named(missing, packages)}; {worker.name} can."
    return None


def fitting(job: Job, workers: Sequence[WorkerInfo]) -> list[WorkerInfo]:
    """The workers that serve the job's queue."""
    queue = queue_name(job.accelerator, job.spec.priority, job.spec.resources.gpus)
    return [worker for worker in workers if queue in worker.queues]


def _with_device(workers: Sequence[WorkerInfo]) -> list[WorkerInfo]:
    return [worker for worker in workers if worker.state != "device_failed"]


def _needed(job: Job, gpus: int) -> str:
    if gpus > 1:
        return f"exactly {gpus} GPUs"
    return {"gpu": "exactly one GPU", "cpu": "a CPU", "any": "one GPU or a CPU"}[job.accelerator]


def _missing(has: Collection[str] | None, packages: Mapping[str, str]) -> list[str]:
    return [] if has is None else [name for name in packages if name not in has]


def _no_package(workers: Sequence[WorkerInfo], packages: Mapping[str, str]) -> str:
    """About the worker that lacks the fewest packages."""
    missing = min((_missing(worker.packages, packages) for worker in workers), key=len)
    what = _named(missing, packages)
    return f"No suitable worker can run {what}: install it there, or choose another."


def _named(missing: Sequence[str], packages: Mapping[str, str]) -> str:
    return " and ".join(f"{packages[name]} ({how_to_install(name)})" for name in missing)


def _has_memory(worker: WorkerInfo, memory: Mapping[Device, Memory]) -> bool:
    need = memory.get(kind_of(worker.device))
    return need is None or worker.memory_bytes is None or need.bytes <= worker.memory_bytes


def _too_large(workers: Sequence[WorkerInfo], memory: Mapping[Device, Memory]) -> str:
    largest = max(workers, key=lambda worker: worker.memory_bytes or 0)
    size, device = largest.memory_bytes or 0, kind_of(largest.device)
    return memory[device].does_not_fit(size, f"the largest {device.upper()} of a worker")
