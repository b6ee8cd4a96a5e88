"""The workers of the record as pools, and the running attempts as what they hold of them. Pure.

Each worker is a pool: it has room for one job on all of its GPUs, or on its CPU.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

from core.devices import gpu_indices
from core.environments.info import Device
from core.jobs.turns import Held, Pool, Started, Who, held_of
from core.jobs.workers import WorkerInfo, kind_of


def pools_of(
    device: Device, workers: Sequence[WorkerInfo], started: Sequence[Started], usual_s: Mapping[Who, float]
) -> tuple[Sequence[Pool], Sequence[Held]]:
    """The workers with this kind of device that take jobs, and what holds them. Now is 0 s.

    usual_s: how long a user's attempts take, as `standings_on` has it.
    """
    ready = [worker for worker in workers if worker.state == "ready" and kind_of(worker.device) == device]
    gpus = {worker.name: max(1, len(gpu_indices(worker.device))) * worker.hosts for worker in ready}
    held = [held_of(one, usual_s) for one in started if one.worker in gpus]
    taken = Counter[str]()
    for one in held:
        taken[one.pool] += one.gpus
    pools = [
        Pool(worker.name, gpus[worker.name], gpus[worker.name] - taken[worker.name], kinds_of(worker))
        for worker in ready
    ]
    return pools, held


def kinds_of(worker: WorkerInfo) -> frozenset[str]:
    """The kinds of slot that it serves, as requests name them."""
    return frozenset(queue.rpartition("-")[0] for queue in worker.queues)
