"""The GPUs of a machine that its workers share out among their jobs.

Each of them has a worker of its own, which tests it. A job of several GPUs runs under one worker, on its GPU
and on others that are lent to it: their workers wait until it has ended. Who holds a GPU's lock has the GPU,
as everywhere (`worker.host.locks`); only one worker of a machine claims a job at a time, so that what it sees
as free stays so until it has locked it.
"""

import json
import os
import socket
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from core.devices import device_name, gpu_indices
from core.errors import Misconfigured
from core.jobs.pools import Offer, name_of
from core.jobs.workers import WorkerInfo
from core.settings import WorkerSettings
from core.variables import variable
from worker.host.device_health import mark_of
from worker.host.locks import is_held, remove_free_locks, remove_lock, slot, slot_names, take_lock

# For so long a worker to which nothing was given looks at the queue no more, unless a GPU becomes free.
_KEPT_S = 10.0
# For so long after GPUs failed together, each of them takes jobs of one GPU alone.
_APART_S = 3600.0
# A lock is held for a moment by whoever looks whether it can go.
_AGAIN_S = 0.05


@dataclass(frozen=True)
class Pool:
    """The part of one worker: its own GPU, and the locks of all by their indices. data_dir: absolute."""

    own: int
    locks: Mapping[int, str]
    data_dir: Path

    @property
    def device(self) -> str:
        """All GPUs."""
        return device_name(self.locks)

    def free(self) -> frozenset[int] | None:
        """The GPUs that work, as far as known, and that nobody uses; None while a worker claims a job."""
        if is_held(self._turn):
            return None
        used = (gpu for gpu in self.locks if self._is_marked(gpu) or is_held(self.lock(gpu)))
        return frozenset(self.locks) - frozenset(used)

    def says_who(self) -> str:
        """A sentence on the job that has the own GPU."""
        with suppress(OSError, ValueError, TypeError, KeyError):
            holder = json.loads(self.lock(self.own).read_text())
            return f"The job {holder['job']} has its GPU: it runs on {holder['device']} of this machine."
        return "Another process of this machine uses its GPU."

    @contextmanager
    def turn(self, called_off: Callable[[], bool]) -> Generator["Turn"]:
        """Alone of all workers of this machine. Raises CalledOff."""
        with slot(self._turn, float("inf"), called_off):
            turn = Turn(self, self._take_free())
            try:
                yield turn
            finally:
                turn.close()

    def note_kept(self, why: str) -> None:
        """Tell the own worker, which reads it before it asks again, why it was given nothing."""
        self._kept.parent.mkdir(parents=True, exist_ok=True)
        self._kept.write_text(why)

    def read_kept(self) -> str | None:
        """What `note_kept` has written, once."""
        try:
            why = self._kept.read_text()
        except OSError:
            return None
        self._kept.unlink(missing_ok=True)
        return why

    @property
    def most_gpus(self) -> int:
        """How many a job may have: one while they are known not to work together."""
        return len(self.locks) if self.why_apart() is None else 1

    def set_apart(self, problem: str) -> None:
        """Note that GPUs of which each one works fail together, for all workers of this machine.

        For an hour: then another job shows whether they do.
        """
        self._apart.parent.mkdir(parents=True, exist_ok=True)
        self._apart.write_text(problem)

    def why_apart(self) -> str | None:
        """What `set_apart` was told; None if the GPUs work together, as far as known."""
        try:
            age_s = time.time() - self._apart.stat().st_mtime
            return self._apart.read_text() if age_s < _APART_S else None
        except OSError:
            return None

    def lock(self, gpu: int) -> Path:
        return self.data_dir / "locks" / f"{self.locks[gpu]}.lock"

    @property
    def _turn(self) -> Path:
        """One for all pools of a machine, whichever GPUs they have."""
        return self.data_dir / "locks" / f"turn-{self._machine}.lock"

    @property
    def _apart(self) -> Path:
        return self.data_dir / "devices" / f"{self._machine}.apart"

    @property
    def _machine(self) -> str:
        return self.locks[self.own].rpartition("-")[0]

    @property
    def _kept(self) -> Path:
        return self.data_dir / "devices" / f"{self.locks[self.own]}.kept"

    def _is_marked(self, gpu: int) -> bool:
        return mark_of(self.data_dir, self.locks[gpu]).exists()

    def _take_free(self) -> dict[int, int]:
        held = dict[int, int]()
        for is_again in (False, True):
            for gpu in self.locks.keys() - held.keys():
                if not self._is_marked(gpu) and (descriptor := take_lock(self.lock(gpu))) is not None:
                    held[gpu] = descriptor
            if is_again or len(held) == len(self.locks):
                break
            time.sleep(_AGAIN_S)
        return held


class Turn:
    """While one worker claims a job: it holds the locks of all free GPUs, and then those that it keeps."""

    def __init__(self, pool: Pool, held: dict[int, int]) -> None:
        self._pool, self._held = pool, held

    def offer(self, workers: Sequence[WorkerInfo]) -> Offer | None:
        """What a job can have; None if the own GPU is not free. workers: all of the service."""
        if self._pool.own not in self._held:
            return None
        name = name_of(self._pool.device, socket.gethostname())
        return Offer(name, self._pool.own, frozenset(self._held), workers)

    def keep(self, device: str, job_id: str) -> "Kept":
        """Give these GPUs to the job."""
        kept = [self._held.pop(gpu) for gpu in gpu_indices(device)]
        for descriptor in kept:
            with suppress(OSError):  # A note for `says_who`; the lock holds also on a full disk.
                os.truncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps({"job": job_id, "device": device}).encode(), 0)
        return Kept(tuple(kept), self._pool.data_dir / "locks")

    def close(self) -> None:
        """Release what no job has."""
        for gpu, descriptor in self._held.items():
            remove_lock(self._pool.lock(gpu), descriptor)
        self._held.clear()


@dataclass(frozen=True)
class Kept:
    """Locks that a job has. They go with the context, or with the process."""

    descriptors: tuple[int, ...]
    folder: Path

    def __enter__(self) -> tuple[int, ...]:
        return self.descriptors

    def __exit__(self, *_: object) -> None:
        for descriptor in self.descriptors:
            os.close(descriptor)
        remove_free_locks(self.folder)


class Membership:
    """Whether a worker of a pool may take a job now. clock: seconds."""

    def __init__(self, pool: Pool, clock: Callable[[], float] = time.monotonic) -> None:
        self.pool = pool
        self.free = frozenset(pool.locks)
        self._clock = clock
        self._kept, self._kept_until, self._kept_at = "", 0.0, frozenset[int]()

    def look(self, *, prepares: bool = False) -> bool:
        """Look again: whether its GPU is free, and nothing is kept from it.

        prepares: whether the worker itself uses its GPU, and would leave it for a job.
        """
        free = self.pool.free()
        if free is not None:
            self.free = free | {self.pool.own} if prepares else free
        if (why := self.pool.read_kept()) is not None:
            self._kept, self._kept_until, self._kept_at = why, self._clock() + _KEPT_S, self.free
        if self._clock() >= self._kept_until or self.free - self._kept_at:
            self._kept = ""
        self._kept_at &= self.free
        return self.state == "ready"

    @property
    def state(self) -> Literal["ready", "lent", "kept"]:
        if self.pool.own not in self.free:
            return "lent"
        return "kept" if self._kept else "ready"

    @property
    def most_gpus(self) -> int:
        """How many a job of this worker could have now."""
        return min(len(self.free), self.pool.most_gpus)

    @property
    def problem(self) -> str | None:
        """A sentence on a state that is not ready, or on GPUs that do not work together."""
        if self.state == "lent":
            return self.pool.says_who()
        if self._kept:
            return self._kept
        if (why := self.pool.why_apart()) is not None:
            return f"It takes only jobs of one GPU for an hour. {why}"
        return None


def pool_of(settings: WorkerSettings, device: str) -> Pool | None:
    """The pool of this worker; None where it serves its own device alone, as a CPU. Raises Misconfigured."""
    if settings.pool is None or device == "cpu":
        return None
    gpus, own = gpu_indices(settings.pool), gpu_indices(device)
    if len(own) != 1 or own[0] not in gpus or settings.hosts > 1:
        raise Misconfigured(
            f"{variable('pool')}={settings.pool} is for workers with one of these GPUs each, on one host; "
            f"this one has {device}. `python -m worker.fleet` starts them."
        )
    names = slot_names(device_name(gpus), os.getpid())
    return Pool(own[0], dict(zip(gpus, names, strict=True)), settings.data_dir.absolute())
