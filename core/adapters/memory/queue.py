"""A job queue in this process' memory."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass
from threading import Lock

from core.jobs.queue import queue_name, queue_names
from core.jobs.spec import Accelerator, Priority
from core.previews.record import PreviewRequest


@dataclass(frozen=True)
class Dispatch:
    """One attempt on its way to a worker."""

    job_id: str
    attempt: int


class MemoryJobQueue:
    """A JobQueue for one process; thread-safe. Its messages can be inspected and taken."""

    def __init__(self) -> None:
        self._waiting: dict[Dispatch, str] = {}
        self._taken: set[Dispatch] = set()
        self._models: list[str] = []
        self._previews: list[PreviewRequest] = []
        self._lock = Lock()

    def enqueue(
        self, job_id: str, attempt: int, *, accelerator: Accelerator, priority: Priority, gpus: int = 1
    ) -> None:
        dispatch = Dispatch(job_id, attempt)
        with self._lock:
            if dispatch not in self._taken:
                self._waiting.setdefault(dispatch, queue_name(accelerator, priority, gpus))

    def num_waiting(self, names: Collection[str]) -> Mapping[str, int]:
        with self._lock:
            waiting = Counter(self._waiting.values())
            return {name: waiting[name] for name in names}

    def contains(self, job_id: str, attempt: int) -> bool:
        dispatch = Dispatch(job_id, attempt)
        with self._lock:
            return dispatch in self._waiting or dispatch in self._taken

    def known(self) -> Collection[tuple[str, int]]:
        with self._lock:
            return {(dispatch.job_id, dispatch.attempt) for dispatch in (*self._waiting, *self._taken)}

    def strays(self) -> Set[str]:
        return frozenset()

    def drop(self, names: Collection[str]) -> None:
        pass

    def remove(self, job_id: str, attempt: int) -> None:
        dispatch = Dispatch(job_id, attempt)
        with self._lock:
            self._waiting.pop(dispatch, None)
            self._taken.discard(dispatch)

    def enqueue_model(self, model_id: str) -> None:
        with self._lock:
            if model_id not in self._models:
                self._models.append(model_id)

    def contains_model(self, model_id: str) -> bool:
        with self._lock:
            return model_id in self._models

    def take_model(self) -> str | None:
        """The next model for a worker, removed at once; None if none waits."""
        with self._lock:
            return self._models.pop(0) if self._models else None

    def enqueue_preview(self, request: PreviewRequest) -> None:
        with self._lock:
            if request not in self._previews:
                self._previews.append(request)

    def contains_preview(self, preview_id: str) -> bool:
        with self._lock:
            return any(request.id == preview_id for request in self._previews)

    def num_previews(self) -> int:
        with self._lock:
            return len(self._previews)

    def take_preview(self) -> PreviewRequest | None:
        """The next request for a worker, removed at once; None if none waits."""
        with self._lock:
            return self._previews.pop(0) if self._previews else None

    def waiting(self) -> Sequence[Dispatch]:
        """The attempts that no worker has taken, oldest first."""
        with self._lock:
            return list(self._waiting)

    def take(self, device: str = "cpu") -> Dispatch | None:
        """The next attempt that a worker on this device would get; None if none waits."""
        with self._lock:
            for name in queue_names(device):
                for dispatch, queue in self._waiting.items():
                    if queue == name:
                        del self._waiting[dispatch]
                        self._taken.add(dispatch)
                        return dispatch
        return None
