"""How many workers to start and to call off: a pure function of what the queue wants and what runs.

A worker without a job ends by itself, so nothing here ends one that runs. What is decided:

- A queued job that no idle worker and no allocation on its way will take gets an allocation.
- A pending allocation that no job wants for a while is called off; one that is stuck, at once.
- A kind pauses after its allocations were refused, or failed before their workers were heard of: 10 s, and
  twice as long each time, up to ten minutes.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

from core.environments.info import Device
from core.jobs.slots import ANY, CPU, GPU, SlotKind, WantedSlots, kind_of_queue
from core.jobs.workers import WorkerInfo
from worker.cluster.launcher import Allocation

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 10.0, 600.0
# After a start whose outcome is not known: the scheduler would show it by then.
_UNKNOWN_PAUSE_S = 60.0
# A worker announces itself every ten seconds.
_SILENT_S = 35.0


@dataclass(frozen=True)
class Limits:
    """most: allocations at once, of all kinds together. most_of: of one kind, where that is limited too.

    kinds: those that can be started. any_as: the one that is started for jobs of the kind `any`.
    settle_s: for how long a pending allocation must be unwanted before it is called off.
    """

    most: int
    kinds: Collection[SlotKind]
    any_as: Device
    most_of: Mapping[SlotKind, int] = field(default_factory=dict[SlotKind, int])
    settle_s: float = 30.0


@dataclass(frozen=True)
class Seen:
    """One look. now_s: of a clock that never goes back. silent_s: since when each worker was heard of."""

    now_s: float
    wanted: Sequence[WantedSlots]
    allocations: Sequence[Allocation]
    workers: Sequence[tuple[WorkerInfo, float]]


@dataclass(frozen=True)
class Memory:
    """What one decision leaves to the next.

    alive: the allocations at the last look. heard: those whose worker has been heard of. called_off: those
    that were asked to end. failures, paused_until_s: by kind. unwanted_since_s: since when a kind has had
    more allocations on their way than jobs.
    """

    alive: Mapping[str, Allocation] = field(default_factory=dict[str, Allocation])
    heard: frozenset[str] = frozenset()
    called_off: frozenset[str] = frozenset()
    failures: Mapping[SlotKind, int] = field(default_factory=dict[SlotKind, int])
    paused_until_s: Mapping[SlotKind, float] = field(default_factory=dict[SlotKind, float])
    unwanted_since_s: Mapping[SlotKind, float] = field(default_factory=dict[SlotKind, float])


@dataclass(frozen=True)
class Decision:
    """starts: how many of each kind. stops: allocations to call off. unserved: queued jobs of kinds that
    cannot be started."""

    starts: Mapping[SlotKind, int]
    stops: Sequence[str]
    unserved: Sequence[WantedSlots]


def lost(seen: Seen, memory: Memory) -> list[Allocation]:
    """The allocations that have ended since the last look before their workers were heard of."""
    listed = {one.id for one in seen.allocations}
    expected = listed | memory.heard | memory.called_off
    return [one for one in memory.alive.values() if one.id not in expected]


def decide(seen: Seen, memory: Memory, limits: Limits) -> tuple[Decision, Memory]:
    """What to do now, and what to remember of it. Kinds whose allocations failed were `refused` before."""
    listed = {one.id: one for one in seen.allocations}
    alive = {one.id: one for one in seen.allocations if one.state in ("pending", "running")}
    idle, heard = _workers(seen, alive)
    coming = [one for one in alive.values() if one.id not in heard]
    works = {alive[one].kind for one in heard - memory.heard}
    stuck = [one.id for one in seen.allocations if one.state == "stuck"]
    memory = replace(
        memory,
        alive=listed,
        heard=(memory.heard | heard) & listed.keys(),
        called_off=(memory.called_off | set(stuck)) & listed.keys(),
        failures={kind: number for kind, number in memory.failures.items() if kind not in works},
    )
    demand = _demand(seen.wanted, idle, limits)
    on_their_way = Counter(one.kind for one in coming)
    starts = _starts(demand, on_their_way, seen, memory, limits, alive.values())
    stops, memory = _stops(demand, on_their_way, coming, seen.now_s, memory, limits)
    unserved = [one for one in seen.wanted if one.queued and _served(one.kind, limits) not in limits.kinds]
    return Decision(starts, [*stuck, *stops], unserved), memory


def refused(memory: Memory, kind: SlotKind, now_s: float) -> Memory:
    """After a refusal, or an allocation that failed: the kind pauses."""
    number = memory.failures.get(kind, 0) + 1
    pause_s = min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2 ** min(number - 1, 10))
    return replace(
        memory,
        failures={**memory.failures, kind: number},
        paused_until_s={**memory.paused_until_s, kind: now_s + pause_s},
    )


def unknown(memory: Memory, kind: SlotKind, now_s: float) -> Memory:
    """After a start whose outcome is not known: it is waited for, so that nothing is started twice."""
    return replace(memory, paused_until_s={**memory.paused_until_s, kind: now_s + _UNKNOWN_PAUSE_S})


def _served(kind: SlotKind, limits: Limits) -> SlotKind:
    """The kind that is started for jobs of this one."""
    if kind != ANY:
        return kind
    return GPU if limits.any_as == "gpu" else CPU


def _workers(seen: Seen, alive: Mapping[str, Allocation]) -> tuple[Counter[SlotKind], set[str]]:
    """How many workers of each kind wait for a job, and the allocations whose workers were heard of.

    A pending allocation has no worker: one that is still listed was there before it was preempted.
    """
    idle, heard, shared = Counter[SlotKind](), set[str](), Counter[tuple[str, str]]()
    running = {one.id for one in alive.values() if one.state == "running"}
    known = {one.id for one in seen.allocations}
    used = {
        (worker.host, worker.device)
        for worker, silent_s in seen.workers
        if worker.pool is not None and (worker.job or worker.jobs) and silent_s <= _SILENT_S
    }
    for worker, silent_s in seen.workers:
        own = (worker.allocation or {}).get("id")
        if silent_s > _SILENT_S or (own in known and own not in running):
            continue
        if own in running:
            heard.add(str(own))
        if worker.job or worker.jobs or worker.state in ("device_failed", "lent", "kept"):
            continue
        if worker.seat > 0:
            continue  # Its GPU is counted by the worker of the first seat.
        if worker.pool is not None:
            if (worker.host, worker.device) not in used:  # Not beside a job on another seat.
                shared[worker.host, worker.pool] += 1
        else:
            idle[_kind_of(worker.queues)] += 1
    return idle + _of_pools(shared.values(), seen.wanted), heard


def _of_pools(free: Iterable[int], wanted: Sequence[WantedSlots]) -> Counter[SlotKind]:
    """The slots that the free GPUs of each pool are for the jobs that wait, the largest first.

    What is left are slots with one GPU.
    """
    idle = Counter[SlotKind]()
    left = {one.kind: one.queued for one in wanted if one.kind.accelerator == "gpu" and one.kind.hosts == 1}
    for number in free:
        for kind in sorted(left, reverse=True):
            slots = min(left[kind], number // kind.gpus)
            idle[kind] += slots
            left[kind] -= slots
            number -= slots * kind.gpus
        idle[GPU] += number
    return idle


def _kind_of(queues: Iterable[str]) -> SlotKind:
    return max((kind_of_queue(name) for name in queues), default=ANY)


def _demand(
    wanted: Sequence[WantedSlots], idle: Counter[SlotKind], limits: Limits
) -> dict[SlotKind, tuple[int, float]]:
    """For each kind that can be started, the jobs that no idle worker takes, and how long the oldest waits.

    A job of the kind `any` is taken by an idle worker with one GPU or with a CPU.
    """
    queued = {one.kind: one.queued for one in wanted}
    ages = {one.kind: one.oldest_queued_s or 0.0 for one in wanted}
    left = {kind: max(0, queued.get(kind, 0) - idle[kind]) for kind in {*queued, *limits.kinds} - {ANY}}
    spare = sum(max(0, idle[kind] - queued.get(kind, 0)) for kind in (CPU, GPU))
    demand = {kind: (number, ages.get(kind, 0.0)) for kind, number in left.items() if kind in limits.kinds}
    if (for_any := max(0, queued.get(ANY, 0) - spare)) and (kind := _served(ANY, limits)) in demand:
        number, age_s = demand[kind]
        demand[kind] = (number + for_any, max(age_s, ages[ANY]))
    return demand


def _starts(  # One look, what was remembered, and what may be.
    demand: Mapping[SlotKind, tuple[int, float]],
    on_their_way: Counter[SlotKind],
    seen: Seen,
    memory: Memory,
    limits: Limits,
    alive: Collection[Allocation],
) -> dict[SlotKind, int]:
    """The kind whose oldest job waits longest comes first, where not all can be started."""
    there = Counter(one.kind for one in alive)
    room, starts = limits.most - len(alive), dict[SlotKind, int]()
    for kind, (number, _) in sorted(demand.items(), key=lambda one: -one[1][1]):
        if memory.paused_until_s.get(kind, -inf) > seen.now_s:
            continue
        own_room = limits.most_of.get(kind, limits.most) - there[kind]
        wanted = min(number - on_their_way[kind], room, own_room)
        if memory.failures.get(kind):  # One is enough to see whether it works again.
            wanted = min(wanted, 1)
        if wanted > 0:
            starts[kind] = wanted
            room -= wanted
    return starts


def _stops(  # As above.
    demand: Mapping[SlotKind, tuple[int, float]],
    on_their_way: Counter[SlotKind],
    coming: Sequence[Allocation],
    now_s: float,
    memory: Memory,
    limits: Limits,
) -> tuple[list[str], Memory]:
    """The newest of the pending ones that have been too many for `settle_s`."""
    since, stops = dict[SlotKind, float](), list[str]()
    for kind, number in on_their_way.items():
        too_many = number - demand.get(kind, (0, 0.0))[0]
        if too_many <= 0:
            continue
        since[kind] = memory.unwanted_since_s.get(kind, now_s)
        if now_s - since[kind] >= limits.settle_s:
            pending = [one.id for one in coming if one.kind == kind and one.state == "pending"]
            stops += pending[-too_many:]
    called_off = memory.called_off | frozenset(stops)
    return stops, replace(memory, unwanted_since_s=since, called_off=called_off)
