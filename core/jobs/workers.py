"""Workers: their reports on themselves, what a job needs of one, and why a queued job waits."""

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib.util import find_spec
from typing import Literal, Protocol

from core.algorithms.memory import MemoryNeed
from core.devices import gpu_indices
from core.documents import Stored
from core.environments import catalog
from core.environments.info import Device
from core.environments.plugins import named_in
from core.errors import GaitwayError
from core.installation import to_install, to_install_robots
from core.jobs.job import Job
from core.jobs.queue import queue_of
from core.jobs.resolved import resolve_job
from core.jobs.slots import kind_of_queue
from core.jobs.spec import JobSpec, TrainSpec
from core.jobs.status import JobStatus
from core.physics.availability import PACKAGES

# A worker names itself by its host, its device and a few random digits.
WORKER_NAME = "[!-~]{1,200}"
_PARTS_OF_NAME = re.compile(r"(?P<host>[^:]+):(?P<device>cpu|gpu(:[0-9,-]+)?)(:[0-9a-f]{6})?")
WorkerState = Literal["ready", "testing", "device_failed", "incomplete", "lent", "kept"]


class WorkerInfo(Stored):
    """A worker's report on itself, which it sends at every heartbeat.

    job: the one that it runs, or whose message it took from the queue. jobs: all whose attempts it runs now;
    no report names them, the store adds them. state: a `ready` worker takes jobs or has one; it takes none
    while it tests its device, after that has failed a test, while it lacks a host, while a job of another
    worker of its pool has its GPU (`lent`), or while GPUs are kept for a larger job (`kept`). problem: a
    sentence on that, or on GPUs of its pool that fail together. hosts: how many machines, each with such a
    device, take a job together. pool: the GPUs of its host, its own among them, that jobs of any number share
    out. seats: how many jobs may share its GPU, each under a worker of its own; seat: which of these it is,
    from 0. memory_bytes: of each device, where known. packages: the optional packages that it has; null if a
    worker of an older version did not report them. allocation: what the cluster that started it calls the
    allocation it runs in.
    """

    name: str
    host: str
    pid: int
    device: str
    hosts: int = 1
    pool: str | None = None
    seats: int = 1
    seat: int = 0
    queues: tuple[str, ...] = ()
    job: str | None = None
    jobs: tuple[str, ...] = ()
    state: WorkerState = "ready"
    problem: str | None = None
    memory_bytes: int | None = None
    packages: tuple[str, ...] | None = None
    allocation: dict[str, str] | None = None
    started_at: datetime
    seen_at: datetime

    @property
    def takes_jobs(self) -> bool:
        """Now, or once those that hold its device have ended."""
        return self.state in ("ready", "lent", "kept")


@dataclass(frozen=True)
class WorkerPage:
    """Some workers by their names, and the cursor of the next page; None at the end."""

    workers: Sequence[WorkerInfo]
    next_cursor: str | None


class WorkerStore(Protocol):
    """Part of the record. Every method raises RecordsUnavailable when the store cannot be reached."""

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        """Store the report, in place of the one before; it counts for `ttl`."""
        ...

    def withdraw(self, name: str) -> None:
        """Forget a worker that has gone."""
        ...

    def workers(self) -> Sequence[WorkerInfo]:
        """All of them, ordered by name. A report that this version cannot read is left out."""
        ...

    def list_workers(self, *, cursor: str | None = None, limit: int = 50) -> WorkerPage:
        """Some of them, ordered by name. cursor: that of an earlier page; Rejected for any other.

        A report that this version cannot read counts and is left out, so a page may have fewer than `limit`.
        """
        ...


# The extra of Gaitway that installs an optional package, by the package's import name.
_EXTRAS: dict[str, str] = {
    **{package: engine for engine, package in PACKAGES.items()},
    "dm_control": "dm-control",
    "biorobot": "brittle-star",
    "mujoco_playground": "playground",
}


def packages_here() -> tuple[str, ...]:
    """The optional packages that are installed here, which are not imported; and the plugins that work."""
    rows = catalog.ENVIRONMENTS.values()
    optional = {*PACKAGES.values(), *(info.package for info in rows if info.package is not None)}
    there = [package for package in optional if find_spec(package) is not None]
    return tuple(sorted((*there, *(plugin.name for plugin in catalog.PLUGINS if not plugin.problem))))


def how_to_install(package: str) -> str:
    """The command that installs an optional package, or only its name. package: its import name, or that of a
    plugin."""
    if (plugin := catalog.plugin_named(package)) is not None:
        return f"the Python package {plugin.package}, here {plugin.version}"
    if package == "mjlab":
        return to_install_robots()
    extra = _EXTRAS.get(package)
    return f"the Python package {package}" if extra is None else to_install(extra)


def packages_for(job: Job) -> Mapping[str, str]:
    """The optional packages and the plugins that the job needs, each with what needs it."""
    environment, needed = job.spec.environment.id, dict[str, str]()
    info = catalog.ENVIRONMENTS.get(environment)
    if info is not None and info.package is not None:
        needed[info.package] = f"the environment {environment}"
    for plugin in named_in(environment, job.spec.environment.options):
        needed[plugin] = f"the terms and bodies {plugin}/…"
    engine = job.spec.physics
    if engine == "auto" and isinstance(job.spec, TrainSpec) and job.begun is not None:
        engine = job.begun.engine  # Its checkpoint was made with it.
    for name, package in PACKAGES.items():
        if name == engine:
            needed[package] = f"the engine {name}"
    return needed


def memory_for(spec: JobSpec) -> Mapping[Device, MemoryNeed]:
    """The least memory that a training needs on each kind of device; empty where that is not known."""
    try:
        return resolve_job(spec).memory
    except GaitwayError:  # A version with other rules accepted it; the attempt says what is wrong.
        return {}


def host_and_device(worker: str) -> tuple[str, str]:
    """The host and the device that a worker's name names; the whole name and "" for any other name."""
    parts = _PARTS_OF_NAME.fullmatch(worker)
    return (parts["host"], parts["device"]) if parts else (worker, "")


def kind_of(device: str) -> Device:
    """The kind of a worker's device."""
    return "gpu" if gpu_indices(device) else "cpu"


def what_it_waits_for(job: Job, workers: Sequence[WorkerInfo]) -> str | None:
    """A sentence if no present worker could run the job; None if one could, or the job is not queued.

    A worker that does not report its packages or memory may have enough.
    """
    if job.status != JobStatus.QUEUED:
        return None
    suitable = fitting(job, workers)
    if not suitable:
        here = sorted({_has(worker) for worker in workers})
        there = f"the workers here have {', '.join(here)}" if here else "no worker is running"
        return f"No worker has {_needed(job)}: {there}."
    able = _with_device(suitable)
    if not able:
        is_device = any(worker.state == "device_failed" for worker in suitable)
        why = (
            "The device of each suitable worker was set aside" if is_device else "Each suitable worker waits"
        )
        return f"{why}: " + _problems(suitable)
    if not _has_gpus(job, able):
        failed = [worker for worker in suitable if worker not in able]
        return f"No host has {job.spec.resources.gpus} GPUs that work. {_problems(failed)}".rstrip()
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


def able_to_run(job: Job, workers: Sequence[WorkerInfo]) -> list[WorkerInfo]:
    """The workers that could run the job once they are free, as far as they report what they have."""
    packages, memory = packages_for(job), memory_for(job.spec)
    return [
        worker
        for worker in _with_device(fitting(job, workers))
        if not _missing(worker.packages, packages) and _has_memory(worker, memory)
    ]


def fitting(job: Job, workers: Sequence[WorkerInfo]) -> list[WorkerInfo]:
    """The workers that serve the job's queue."""
    queue = queue_of(job)
    return [worker for worker in workers if queue in worker.queues]


def _with_device(workers: Sequence[WorkerInfo]) -> list[WorkerInfo]:
    """Those that may take the job once they are free: with a device that works, and all of their hosts."""
    return [worker for worker in workers if worker.state not in ("device_failed", "incomplete")]


def _has_gpus(job: Job, workers: Sequence[WorkerInfo]) -> bool:
    """Whether one of them has enough, or all of a pool together."""
    if any(worker.pool is None for worker in workers):
        return True
    devices = {(one.host, one.pool, one.device) for one in workers}
    return max(Counter(device[:2] for device in devices).values()) >= job.spec.resources.gpus


def _problems(workers: Sequence[WorkerInfo]) -> str:
    return " ".join(f"{worker.name}: {worker.problem}" for worker in workers)


def _has(worker: WorkerInfo) -> str:
    if worker.pool is not None:
        gpus = f"{len(gpu_indices(worker.pool))} GPUs of one host"
        are_shared_out = any(kind_of_queue(queue).gpus > 1 for queue in worker.queues)
        return gpus if are_shared_out else f"{gpus} that fail together"
    return worker.device if worker.hosts == 1 else f"{worker.device} on each of {worker.hosts} hosts"


def _needed(job: Job) -> str:
    gpus, hosts = job.spec.resources.gpus, job.spec.resources.hosts
    if hosts > 1:
        each = f"exactly {gpus // hosts} GPU{'s' * (gpus > hosts)}" if job.accelerator == "gpu" else "a CPU"
        return f"{each} on each of exactly {hosts} hosts"
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


def _has_memory(worker: WorkerInfo, memory: Mapping[Device, MemoryNeed]) -> bool:
    need = memory.get(kind_of(worker.device))
    return need is None or worker.memory_bytes is None or need.bytes <= worker.memory_bytes


def _too_large(workers: Sequence[WorkerInfo], memory: Mapping[Device, MemoryNeed]) -> str:
    largest = max(workers, key=lambda worker: worker.memory_bytes or 0)
    size, device = largest.memory_bytes or 0, kind_of(largest.device)
    return memory[device].does_not_fit(size, f"the largest {device.upper()} of a worker")
