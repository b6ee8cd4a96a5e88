"""The interface of the queue that brings jobs to workers. The truth is in the record, never in the queue."""

from collections.abc import Collection, Mapping, Sequence, Set
from typing import Protocol

from core.devices import gpu_indices
from core.jobs.job import Job
from core.jobs.spec import MOST_GPUS, Accelerator, Priority
from core.previews.record import PreviewQueue
from core.uploads.record import UploadQueue

# The queues of what somebody waits for at a screen: one of each comes before the next job.
PREVIEWS, MODELS = "gaitway-previews", "gaitway-models"
# The names of queues of jobs on several hosts begin like this.
SEVERAL_HOSTS = "gaitway-hosts"
PRIORITIES: tuple[Priority, ...] = ("high", "normal", "low")
# How many messages wait in one queue at most: more than workers take until the reconciler looks again, and so
# few that all queues together fit into a small Redis. The record holds the rest. A submission hands itself
# over only to a queue that is less than half full: what waits in the record longer keeps its turn.
MOST_WAITING, MOST_SUBMITTED = 200, 100


class JobQueue(PreviewQueue, UploadQueue, Protocol):
    """At-least-once dispatch of jobs, of files to validate, and of previews.

    The message of an attempt says that there is work for slots of a kind: the worker that takes it claims the
    job whose turn it is (`core.jobs.turns`). So there are about as many messages as jobs that wait, and it
    does no harm that one comes twice or finds nothing to do.

    Every method raises RecordsUnavailable when the queue cannot be reached.
    """

    def enqueue(self, job_id: str, attempt: int, *, name: str, again: bool = False) -> None:
        """Put this attempt into the queue of this name. Doing so twice changes nothing.

        again: also if a worker has taken its message, which then has claimed another job by it.
        """
        ...

    def num_waiting(self, names: Collection[str]) -> Mapping[str, int]:
        """How many messages wait in each of these queues, in a single read."""
        ...

    def contains(self, job_id: str, attempt: int) -> bool:
        """Whether the attempt waits, or a worker has just taken it."""
        ...

    def known(self) -> Collection[tuple[str, int]]:
        """Every job and attempt that waits, or that a worker has taken, in a single read."""
        ...

    def taken(self) -> Collection[tuple[str, int]]:
        """Those of the known that only a worker has, which may have claimed another job by the message."""
        ...

    def strays(self) -> Set[str]:
        """The queue's names of messages that neither wait nor belong to a worker, and that it keeps for ever:
        their worker was killed, or could not reach the queue at the end."""
        ...

    def drop(self, names: Collection[str]) -> None:
        """Forget these messages."""
        ...

    def remove(self, job_id: str, attempt: int) -> None:
        """Forget the attempt, wherever it is; a missing one is no error."""
        ...


def looks_at_models(queues: Collection[str]) -> bool:
    """Whether a worker that serves these queues validates models and draws previews."""
    return PREVIEWS in queues


def queue_names(device: str, hosts: int = 1, pool: int = 1) -> tuple[str, ...]:
    """The queues a worker on this device serves, most urgent first.

    hosts: the number of machines, each with such a device, that take a job together. pool: how many GPUs
    jobs share out among themselves, where this device is one of them.
    """
    gpus = len(gpu_indices(device))
    shared = SHARED if gpus else ()
    if hosts > 1:
        kind: Accelerator = "gpu" if gpus else "cpu"
        return tuple(queue_name(kind, priority, gpus * hosts or 1, hosts) for priority in PRIORITIES)
    if gpus > 1:
        return tuple(queue_name("gpu", priority, gpus) for priority in PRIORITIES)
    kinds: tuple[Accelerator, ...] = ("gpu", "any") if gpus else ("cpu", "any")
    return (
        PREVIEWS,
        MODELS,
        *(
            name
            for priority in PRIORITIES
            for name in (
                *(queue_name(kind, priority) for kind in kinds),
                *(queue_name("gpu", priority, several) for several in range(2, pool + 1)),
                *(name for name in shared if name.endswith(f"-{priority}")),
            )
        ),
    )


def queue_name(
    accelerator: Accelerator, priority: Priority, gpus: int = 1, hosts: int = 1, *, shares: bool = False
) -> str:
    """The queue of jobs with these needs; gpus: on all hosts together; shares: with other jobs.

    Each number of GPUs and of hosts has its own, so that no worker's GPU idles.
    """
    several = f"{SEVERAL_HOSTS}{hosts}-" if hosts > 1 else "gaitway-"
    return f"{several}{accelerator}{gpus if gpus > 1 else ''}{'-shared' if shares else ''}-{priority}"


# The queues of jobs that share a GPU.
SHARED = tuple(queue_name("gpu", priority, shares=True) for priority in PRIORITIES)


def queue_of(job: Job) -> str:
    """The queue of the job's next attempt."""
    resources = job.spec.resources
    return queue_name(
        job.accelerator, job.spec.priority, resources.gpus, resources.hosts, shares=resources.share_gpu
    )


def all_queues(of_several_hosts: Collection[str] = ()) -> Sequence[str]:
    """Every queue of jobs, the most urgent first.

    of_several_hosts: the queues of jobs on several hosts that are to be among them; there could be thousands.
    """
    one: tuple[Accelerator, ...] = ("gpu", "cpu", "any")
    return [
        name
        for priority in PRIORITIES
        for name in (
            *(queue_name(kind, priority) for kind in one),
            queue_name("gpu", priority, shares=True),
            *(queue_name("gpu", priority, gpus) for gpus in range(2, MOST_GPUS + 1)),
            *(name for name in sorted(of_several_hosts) if name.endswith(f"-{priority}")),
        )
    ]
