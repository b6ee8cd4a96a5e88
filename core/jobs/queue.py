"""The seam to whatever brings jobs to workers. It is never asked what is true."""

from collections.abc import Collection, Set
from typing import Protocol

from core.devices import gpu_indices
from core.jobs.spec import Accelerator, Priority
from core.previews.queue import PreviewQueue
from core.user_models.queue import ModelQueue

# Where previews wait, which go before all jobs; and models, which a worker without jobs looks at.
FIRST, LAST = "gaitway-any-high", "gaitway-models"
PRIORITIES: tuple[Priority, ...] = ("high", "normal", "low")


class JobQueue(ModelQueue, PreviewQueue, Protocol):
    """At-least-once dispatch, of jobs, of models and of previews.

    A job handed out twice is claimed once, by the store's compare-and-set.

    Every method raises RecordsUnavailable when the queue cannot be reached.
    """

    def enqueue(
        self, job_id: str, attempt: int, *, accelerator: Accelerator, priority: Priority, gpus: int = 1
    ) -> None:
        """Hand this attempt to a worker that fits. The same attempt twice is the same as once."""
        ...

    def contains(self, job_id: str, attempt: int) -> bool:
        """Whether the attempt waits, or a worker has just taken it."""
        ...

    def known(self) -> Collection[tuple[str, int]]:
        """Every job and attempt that waits, or that a worker has taken; in one look, however many."""
        ...

    def strays(self) -> Set[str]:
        """The queue's names of messages that neither wait nor belong to a worker, and that it keeps for ever:
        whoever had them was killed, or could not reach the queue at the end."""
        ...

    def drop(self, names: Collection[str]) -> None:
        """Forget these messages."""
        ...

    def remove(self, job_id: str, attempt: int) -> None:
        """Forget the attempt, wherever it is; not there is no error."""
        ...


def looks_at_models(queues: Collection[str]) -> bool:
    """Whether a worker that serves these queues validates models and draws previews."""
    return FIRST in queues


def queue_names(device: str) -> tuple[str, ...]:
    """The queues a worker on this device serves, most urgent first."""
    if (gpus := len(gpu_indices(device))) > 1:
        return tuple(queue_name("gpu", priority, gpus) for priority in PRIORITIES)
    kinds: tuple[Accelerator, ...] = ("gpu", "any") if gpus else ("cpu", "any")
    return (*(queue_name(kind, priority) for priority in PRIORITIES for kind in kinds), LAST)


def queue_name(accelerator: Accelerator, priority: Priority, gpus: int = 1) -> str:
    """The queue of jobs that want this. Each number of GPUs has its own, so that none of a worker's idles."""
    return f"gaitway-{accelerator}{gpus if gpus > 1 else ''}-{priority}"
