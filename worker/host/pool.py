"""The GPUs of a machine that its workers share out among their jobs.

Each of them has a worker of its own, which tests it. A job of several GPUs runs under one worker, on its GPU
and on others that are lent to it: their workers wait until it has ended. Who holds a GPU's lock has the GPU,
as everywhere (`worker.host.locks`); only one worker of a machine claims a job at a time, so that what it sees
as free stays so until it has locked it.

Jobs that share a GPU run under workers of its own, one for each seat. They share the GPU's lock, so that no
other job gets it, and each has the lock of its seat, in which its part of the memory is written.
"""

import json
import os
import socket
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from core.devices import device_name, gpu_indices
from core.errors import Misconfigured
from core.jobs.pools import Offer, name_of
from core.jobs.slots import SlotKind
from core.jobs.workers import WorkerInfo
from core.settings import WorkerSettings
from core.variables import variable
from worker.host.device_health import mark_of
from worker.host.locks import (
    is_held,
    remove_free_locks,
    remove_lock,
    share_lock,
    slot,
    slot_names,
    take_lock,
)

# For so long a worker to which nothing was given looks at the queue no more, unless a GPU becomes free.
_KEPT_S = 10.0
# For so long after GPUs failed together, each of them takes jobs of one GPU alone.
_APART_S = 3600.0
# A lock is held for a moment by whoever looks whether it can go.
_AGAIN_S = 0.05


@dataclass(frozen=True)
class Pool:
    """The part of one worker: its own GPU, and the locks of all by their indices. data_dir: absolute.

    seat: its seat on that GPU, of this number of seats.
    """

    own: int
    locks: Mapping[int, str]
    data_dir: Path
    seat: int = 0
    seats: int = 1

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

    def parts(self) -> Sequence[float] | None:
        """What jobs that share the own GPU have of its memory, if this worker's job may join them."""
        path = self.lock(self.own)
        if self._is_marked(self.own) or not path.exists() or is_held(self.seat_lock(self.seat)):
            return None
        if (descriptor := take_lock(path, shared=True)) is None:
            return None
        os.close(descriptor)
        return self._parts() or None

    def taken_seats(self) -> frozenset[str]:
        """The seats of this machine that jobs have, by their locks."""
        held = (path for path in (self.data_dir / "locks").glob("*-seat*.lock") if is_held(path))
        return frozenset(path.name for path in held)

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
            turn = Turn(self, self._take_free(), self._join())
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

    def seat_lock(self, seat: int) -> Path:
        return self.data_dir / "locks" / f"{self.locks[self.own]}-seat{seat}.lock"

    def _parts(self) -> list[float]:
        """Those of the seats that jobs have; one that says nothing counts as all."""
        found = list[float]()
        for path in filter(is_held, map(self.seat_lock, range(self.seats))):
            try:
                found.append(float(json.loads(path.read_text())["part"]))
            except (OSError, ValueError, TypeError, KeyError):
                found.append(1.0)
        return found

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
        return self.data_dir / "devices" / f"{self.locks[self.own]}-seat{self.seat}.kept"

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

    def _join(self) -> "Joined | None":
        """The lock of the own GPU, shared, and that of the seat; None where no job shares the GPU."""
        if (parts := self.parts()) is None or (seat := take_lock(self.seat_lock(self.seat))) is None:
            return None
        if (gpu := take_lock(self.lock(self.own), shared=True)) is None:
            remove_lock(self.seat_lock(self.seat), seat)
            return None
        return Joined(gpu, seat, parts)


@dataclass(frozen=True)
class Joined:
    """The descriptors of the locks of a GPU that others share, and of a seat. parts: those of the others."""

    gpu: int
    seat: int
    parts: Sequence[float]


class Turn:
    """While one worker claims a job: it holds the locks of all free GPUs, and then those that it keeps."""

    def __init__(self, pool: Pool, held: dict[int, int], joined: Joined | None = None) -> None:
        self._pool, self._held, self._joined = pool, held, joined

    def offer(self, workers: Sequence[WorkerInfo]) -> Offer | None:
        """What a job can have; None if the own GPU is not free, and nobody may join the jobs that share it.
        workers: all of the service."""
        name = name_of(self._pool.device, socket.gethostname())
        free = frozenset(self._held)
        if self._pool.own in free:
            return Offer(name, self._pool.own, free, workers)
        if self._joined is not None:
            return Offer(name, self._pool.own, free, workers, self._joined.parts)
        return None

    def keep(self, device: str, job_id: str, part: float | None = None) -> "Kept":
        """Give these GPUs to the job; part: of the own one's memory, if the job shares it."""
        note = {"job": job_id, "device": device}
        if part is None:
            kept = [self._held.pop(gpu) for gpu in gpu_indices(device)]
            for descriptor in kept:
                _write(descriptor, note)
            return Kept(tuple(kept), self._pool.data_dir / "locks")
        if self._joined is None:
            gpu = self._held.pop(self._pool.own)
            os.truncate(gpu, 0)
            gpu = share_lock(self._pool.lock(self._pool.own), gpu)
            seat = _wait_for_seat(self._pool.seat_lock(self._pool.seat))
        else:
            gpu, seat, self._joined = self._joined.gpu, self._joined.seat, None
        _write(seat, {**note, "part": part})
        return Kept((gpu, seat), self._pool.data_dir / "locks")

    def close(self) -> None:
        """Release what no job has."""
        for gpu, descriptor in self._held.items():
            remove_lock(self._pool.lock(gpu), descriptor)
        self._held.clear()
        if self._joined is not None:
            os.close(self._joined.gpu)
            remove_lock(self._pool.seat_lock(self._pool.seat), self._joined.seat)
            self._joined = None


def _write(descriptor: int, note: Mapping[str, Any]) -> None:
    """A note for `says_who`, or for those who share the GPU."""
    with suppress(OSError):  # The lock holds also on a full disk.
        os.truncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(note).encode(), 0)


def _wait_for_seat(path: Path) -> int:
    """The lock of a seat that nobody has, but perhaps somebody looks at."""
    while (descriptor := take_lock(path)) is None:
        time.sleep(_AGAIN_S)
    return descriptor


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
        self._parts: Sequence[float] | None = None
        self._clock = clock
        self._kept, self._kept_until, self._kept_at = "", 0.0, frozenset[int]()
        self._taken, self._kept_with = frozenset[str](), frozenset[str]()

    def look(self, *, prepares: bool = False) -> bool:
        """Look again: whether its GPU is free or has a seat, and nothing is kept from it.

        prepares: whether the worker itself uses its GPU, and would leave it for a job.
        """
        free = self.pool.free()
        if free is not None:
            self.free = free | {self.pool.own} if prepares else free
            self._parts = None if self.pool.own in self.free else self.pool.parts()
            self._taken = self.pool.taken_seats()
        if (why := self.pool.read_kept()) is not None:
            self._kept, self._kept_until, self._kept_at = why, self._clock() + _KEPT_S, self.free
            self._kept_with = self._taken
        if self._clock() >= self._kept_until or self.free - self._kept_at or self._taken != self._kept_with:
            self._kept = ""
        self._kept_at &= self.free
        return self.state == "ready"

    def asks(self, kind: SlotKind, *, shared: bool) -> bool:
        """Whether it can take such a job now. kind: `any` for what needs no GPU. shared: of a GPU's part."""
        if self.pool.own in self.free:
            return kind.gpus <= self.most_gpus
        return shared

    @property
    def state(self) -> Literal["ready", "lent", "kept"]:
        if self.pool.own not in self.free and self._parts is None:
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
    locks = dict(zip(gpus, names, strict=True))
    return Pool(own[0], locks, settings.data_dir.absolute(), settings.seat, settings.seats)
