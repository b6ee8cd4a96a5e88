"""The workers of the record as pools, and the running attempts as what they hold of them. Pure.

The workers of a machine that share out its GPUs are one pool. Each other worker is a pool that has room for
one job, on all of its GPUs or on its CPU.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from core.devices import device_name, gpu_indices
from core.environments.info import Device
from core.jobs.turns import (
    Held,
    Pool,
    Request,
    Started,
    TurnFacts,
    Who,
    choose,
    held_of,
    in_order,
    standings_on,
)
from core.jobs.workers import WorkerInfo, host_and_device, kind_of

# The detail of an attempt that says which GPUs of a pool it was given, as a device's name.
GIVEN = "gpus"


@dataclass(frozen=True)
class Offer:
    """What a worker of a pool can give a job now. pool: its name, as `name_of` makes it. own: the worker's
    GPU, which each of its jobs has. free: the GPUs without a job, the own one among them. workers: all."""

    pool: str
    own: int
    free: frozenset[int]
    workers: Sequence[WorkerInfo] = ()

    def device(self, gpus: int) -> str:
        """So many of the free GPUs, as a device's name: of the smallest aligned block that has them, such as
        4 to 7, so that large blocks stay whole and a job's GPUs are neighbours."""
        size = 1
        while len(block := [gpu for gpu in self.free if gpu // size == self.own // size]) < gpus:
            size *= 2
        return device_name(sorted(block, key=lambda gpu: (abs(gpu - self.own), gpu))[:gpus])


class NothingFits(Exception):
    """Jobs wait that an offer is too small for, or that would delay a larger one: the first of these."""

    def __init__(self, request: Request, free: int) -> None:
        verb = "is" if free == 1 else "are"
        super().__init__(
            f"The job {request.id} comes first, and needs {request.gpus} GPUs; {free} {verb} free here."
        )
        self.request = request


def choose_for(offer: Offer, requests: Sequence[Request], facts: TurnFacts) -> Request | None:
    """The waiting job that may have what is offered; None if none has a turn. Raises NothingFits."""
    standings, usual_s = standings_on("gpu", facts.shares, facts.started, facts.quotas)
    known, running = pools_of("gpu", offer.workers, facts.started, usual_s)
    own = _with_offer(offer, known)
    pools = [own, *(pool for pool in known if pool.name != own.name)]
    ordered = [
        replace(request, expected_s=usual_s.get(request.who)) for request in in_order(requests, standings)
    ]
    chosen = choose(own, ordered, pools, running, 0.0)
    if chosen is None and ordered:
        too_large = (one for one in ordered if own.could_hold(one) and not own.has_room(one))
        raise NothingFits(next(too_large, ordered[0]), own.free)
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
    held = [
        replace(held_of(one, usual_s), pool=home)
        for one in started
        if (home := homes.get(one.worker) or gone.get(host_and_device(one.worker)))
    ]
    taken = Counter[str]()
    for one in held:
        taken[one.pool] += one.gpus
    pools = list[Pool]()
    for name, group in members.items():
        gpus = _num_gpus(group)
        kinds = frozenset[str]().union(*map(kinds_of, group))
        free = max(0, min(gpus - taken[name], gpus - _num_used(group)))
        pools.append(Pool(name, gpus, free, kinds, is_shared=group[0].pool is not None))
    return pools, held


def kinds_of(worker: WorkerInfo) -> frozenset[str]:
    """The kinds of slot that it serves, as requests name them."""
    return frozenset(queue.rpartition("-")[0] for queue in worker.queues)


def _with_offer(offer: Offer, pools: Sequence[Pool]) -> Pool:
    """The worker's own pool, with what is free there by its own look: the record may not have heard of the
    worker yet, or that a process still holds a GPU."""
    free = len(offer.free)
    for pool in pools:
        if pool.name == offer.pool:
            return replace(pool, gpus=max(pool.gpus, free), free=free)
    return Pool(offer.pool, free, free, is_shared=True)


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
