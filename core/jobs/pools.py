"""The workers of the record as pools, and the running attempts as what they hold of them. Pure.

The workers of a machine that share out its GPUs are one pool. Each other worker is a pool that has room for
one job, on all of its GPUs or on its CPU.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from core.algorithms.memory import shown
from core.devices import device_name, gpu_indices
from core.environments.info import Device
from core.jobs.sharing import shared_bytes
from core.jobs.turns import (
    Held,
    Pool,
    Request,
    SharedGpu,
    Started,
    TurnFacts,
    Who,
    choose,
    held_of,
    in_order,
    standings_on,
    together,
)
from core.jobs.workers import WorkerInfo, host_and_device, kind_of

# The detail of an attempt that says which GPUs of a pool it was given, as a device's name.
GIVEN = "gpus"


@dataclass(frozen=True)
class Offer:
    """What a worker of a pool can give a job now. pool: its name, as `name_of` makes it. own: the worker's
    GPU, which each of its jobs has. free: the GPUs without a job, the own one among them. parts: if the own
    one is not, what jobs that share it have of its memory. workers: all."""

    pool: str
    own: int
    free: frozenset[int]
    workers: Sequence[WorkerInfo] = ()
    parts: Sequence[float] = ()

    @property
    def card(self) -> "Card":
        """A GPU of the pool, as its workers report it."""
        return card_of([worker for worker in self.workers if pool_of(worker) == self.pool])

    def given_to(self, request: Request) -> tuple[str, float | None]:
        """The GPUs for the job, as a device's name; and its part of the own one's memory, if it shares."""
        card, memory = self.card, request.memory
        if memory is None or memory > card.shared_bytes:
            return self.device(request.gpus), None
        return device_name([self.own]), memory / card.memory_bytes

    def device(self, gpus: int) -> str:
        """So many of the free GPUs, as a device's name: of the smallest aligned block that has them, such as
        4 to 7, so that large blocks stay whole and a job's GPUs are neighbours."""
        size = 1
        while len(block := [gpu for gpu in self.free if gpu // size == self.own // size]) < gpus:
            size *= 2
        return device_name(sorted(block, key=lambda gpu: (abs(gpu - self.own), gpu))[:gpus])


@dataclass(frozen=True)
class Card:
    """A GPU of a pool. memory_bytes: 0 where it is not known. seats: how many jobs may share it."""

    memory_bytes: int
    seats: int

    @property
    def shared_bytes(self) -> int:
        """What of its memory they can have together; 0 where none may."""
        return shared_bytes(self.memory_bytes, self.seats) if self.seats > 1 else 0


class NothingFits(Exception):
    """Jobs wait that an offer is too small for, that would delay a larger one, or that are left to workers of
    other GPUs: the first of these."""

    def __init__(self, request: Request, offer: Pool, *, is_left: bool = False) -> None:
        needs = f"needs {request.gpus} GPUs" if request.gpus > 1 else "needs a GPU"
        has = f"{offer.free} {'is' if offer.free == 1 else 'are'} free here"
        if is_left:
            needs, has = "shares a GPU", "another one has room for it"
        elif offer.may_share(request):
            needs, has = f"needs {shown(request.memory or 0)} of a GPU", "this one has not as much"
        super().__init__(f"The job {request.id} comes first, and {needs}; {has}.")
        self.request = request


def choose_for(offer: Offer, requests: Sequence[Request], facts: TurnFacts) -> Request | None:
    """The waiting job that may have what is offered; None if none has a turn. Raises NothingFits.

    A job that can share a GPU with others is left to the workers of that one, so that whole GPUs stay free.
    """
    standings, usual_s = standings_on("gpu", facts.shares, facts.started, facts.quotas)
    known, running = pools_of("gpu", offer.workers, facts.started, usual_s)
    own = _with_offer(offer, known)
    pools = [own, *(pool for pool in known if pool.name != own.name)]
    ordered = [
        replace(request, expected_s=usual_s.get(request.who)) for request in in_order(requests, standings)
    ]
    if offer.own in offer.free:
        here = replace(own, shared={})
        left = [request for request in ordered if own.joined(request) is None]
    else:
        gpu = device_name([offer.own])
        here, left = replace(own, free=0, shared={gpu: own.shared[gpu]}), ordered
    chosen = choose(here, left, pools, running, 0.0)
    if chosen is None and left:
        too_large = (one for one in left if own.could_hold(one) and not own.has_room(one))
        raise NothingFits(next(too_large, left[0]), here)
    if chosen is None and ordered:
        raise NothingFits(ordered[0], here, is_left=True)
    return chosen


def pools_of(
    device: Device, workers: Sequence[WorkerInfo], started: Sequence[Started], usual_s: Mapping[Who, float]
) -> tuple[Sequence[Pool], Sequence[Held]]:
    """The pools of this kind of device that take jobs, and what holds them. Now is 0 s.

    usual_s: how long a user's attempts take, as `standings_on` has it.
    """
    able = [worker for worker in workers if worker.takes_jobs and kind_of(worker.device) == device]
    members = defaultdict[str, list[WorkerInfo]](list)
    for worker in able:
        members[pool_of(worker)].append(worker)
    homes = {worker.name: name for name, group in members.items() for worker in group}
    gone = _pools_by_gpu(able)
    cards = {name: card_of(group) for name, group in members.items()}
    held = [
        _held_in(home, cards[home], one, usual_s)
        for one in started
        if (home := homes.get(one.worker) or gone.get(host_and_device(one.worker)))
    ]
    return [_pool(name, group, cards[name], held) for name, group in members.items()], held


def _held_in(home: str, card: Card, one: Started, usual_s: Mapping[Who, float]) -> Held:
    held = replace(held_of(one, usual_s), pool=home)
    if one.part is None:
        return held
    # A job that shares a GPU has that of its worker.
    return replace(held, shares=host_and_device(one.worker)[1], memory=int(one.part * card.memory_bytes))


def _pool(name: str, group: Sequence[WorkerInfo], card: Card, held: Sequence[Held]) -> Pool:
    gpus, kinds = _num_gpus(group), frozenset[str]().union(*map(kinds_of, group))
    pool = Pool(name, gpus, 0, kinds, group[0].pool is not None, card.seats, card.shared_bytes)
    by_gpu, shared = together(pool, held), dict[str, SharedGpu]()
    for jobs in by_gpu:
        if gpu := jobs[0].shares:
            idle = sum(worker.device == gpu and not worker.jobs for worker in group)
            seats = max(0, min(card.seats - len(jobs), idle))
            shared[gpu] = SharedGpu(seats, card.shared_bytes - sum(one.memory for one in jobs))
    taken = sum(jobs[0].gpus for jobs in by_gpu)
    free = max(0, min(gpus - taken, gpus - _num_used(group)))
    return replace(pool, free=free, shared=shared)


def card_of(group: Sequence[WorkerInfo]) -> Card:
    """The smallest GPU of these workers."""
    sizes = [worker.memory_bytes or 0 for worker in group]
    seats = [worker.seats for worker in group if worker.pool is not None]
    return Card(min(sizes, default=0), min(seats, default=1))


def kinds_of(worker: WorkerInfo) -> frozenset[str]:
    """The kinds of slot that it serves, as requests name them."""
    return frozenset(queue.rpartition("-")[0] for queue in worker.queues)


def _with_offer(offer: Offer, pools: Sequence[Pool]) -> Pool:
    """The worker's own pool, with what is free there by its own look: the record may not have heard of the
    worker yet, or that a process still holds a GPU."""
    free, card = len(offer.free), offer.card
    unknown = Pool(offer.pool, free, free, is_shared=True, seats=card.seats, gpu_bytes=card.shared_bytes)
    pool = next((pool for pool in pools if pool.name == offer.pool), unknown)
    shared = {gpu: one for gpu, one in pool.shared.items() if not offer.free.intersection(gpu_indices(gpu))}
    if offer.own not in offer.free:
        used = int(sum(offer.parts) * card.memory_bytes)
        shared[device_name([offer.own])] = SharedGpu(1, card.shared_bytes - used)
    return replace(pool, gpus=max(pool.gpus, free), free=free, shared=shared)


def pool_of(worker: WorkerInfo) -> str:
    """The name of its pool: that of its machine's GPUs, or its own."""
    return name_of(worker.pool, worker.host) or worker.name


def name_of(pool: str | None, host: str) -> str:
    """Of the pool of these GPUs on this host; empty for a worker that belongs to none."""
    return f"{host}/{pool}" if pool else ""


def _pools_by_gpu(workers: Sequence[WorkerInfo]) -> dict[tuple[str, str], str]:
    """The pool of each GPU: an attempt outlives its worker for a while, or that of an earlier start."""
    shared = {(worker.host, worker.pool) for worker in workers if worker.pool is not None}
    return {(host, f"gpu:{gpu}"): name_of(pool, host) for host, pool in shared for gpu in gpu_indices(pool)}


def _num_gpus(group: Sequence[WorkerInfo]) -> int:
    """One for each device of a pool, which may have a new worker beside the report of the last one."""
    one = group[0]
    if one.pool is not None:
        return len({worker.device for worker in group})
    return max(1, len(gpu_indices(one.device))) * one.hosts


def _num_used(group: Sequence[WorkerInfo]) -> int:
    """How many GPUs of a pool are in use as their workers say: also by a process that is no attempt's."""
    return len({worker.device for worker in group if worker.state == "lent" or (worker.pool and worker.jobs)})
