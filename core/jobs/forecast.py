"""When a waiting job should start, how many are before it, and why it waits: an estimate. Pure."""

import math
from bisect import insort
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from core.algorithms.memory import shown
from core.environments.info import Device
from core.jobs.pools import pools_of
from core.jobs.turns import Held, Pool, Request, Standings, TurnFacts, in_order, standings_on, together
from core.jobs.workers import WorkerInfo

# A job that has run for longer than usual ends in about so many seconds.
_OVERDUE_S = 60.0
# How the kind of a job ends that shares a GPU.
_SHARED = "-shared"
# In which time a job that makes room has kept its checkpoint and ended, if its epochs are short.
_DRAIN_S = 15.0


@dataclass(frozen=True, slots=True)
class LaneKind:
    """Lanes of which it does not matter which one a job takes. kinds: of requests that they take.

    pool: its name, if a job takes a lane a GPU. seats: how many jobs may share such a GPU. is_part: of a GPU
    that jobs share, for one more.
    """

    kinds: frozenset[str]
    pool: str = ""
    seats: int = 1
    is_part: bool = False

    def takes(self, request: Request) -> bool:
        return request.kind in self.kinds and not (self.is_part and request.memory is None)

    def lanes_for(self, request: Request) -> int:
        """How many of them the job takes."""
        return request.gpus if self.pool and not self.is_part else 1


@dataclass(frozen=True, slots=True)
class Lane:
    """A slot for one job at a time, or a GPU of a pool. free_s: in how many seconds it is free, an estimate;
    None where nobody knows."""

    kind: LaneKind
    free_s: float | None


@dataclass(frozen=True, slots=True)
class Forecast:
    """before: how many jobs start before it in slots that it could have. starts_s: in how many seconds it
    should start, by measured durations; None without an estimate. reason: a sentence."""

    before: int
    starts_s: float | None
    reason: str


def forecasts_of(
    facts: TurnFacts, workers: Sequence[WorkerInfo], rooms: Mapping[str, Sequence[str]]
) -> Mapping[str, Forecast]:
    """By the job's id, if there is a worker for it; the earlier one of a GPU's and a CPU's.

    rooms: by the waiting job's id those that make room for it now, in words.
    """
    found = dict[str, Forecast]()
    devices: Sequence[Device] = ("gpu", "cpu")
    for device in devices:
        standings, usual_s = standings_on(device, facts.shares, facts.started, facts.quotas)
        pools, running = pools_of(device, workers, facts.started, usual_s)
        lanes = [lane for pool in pools for lane in _lanes(pool, running)]
        kinds = frozenset[str]().union(*(lane.kind.kinds for lane in lanes))
        requests = [
            replace(request, expected_s=usual_s.get(request.who))
            for request in facts.waiting
            if request.kind in kinds
        ]
        mean_s = sum(usual_s.values()) / len(usual_s) if usual_s else None
        for job, forecast in forecasts(requests, lanes, standings, mean_s).items():
            if job not in found or _start(forecast) < _start(found[job]):
                found[job] = forecast
    return found | {job: _gets_room(found[job], rooms[job]) for job in rooms if job in found}


def _gets_room(forecast: Forecast, drained: Sequence[str]) -> Forecast:
    one, *more = drained
    does = "make room for it, and go" if more else "makes room for it, and goes"
    names = " and ".join([one[0].upper() + one[1:], *more])
    return Forecast(0, min(_start(forecast), _DRAIN_S), f"{names} {does} on later.")


def _lanes(pool: Pool, running: Sequence[Held]) -> Iterator[Lane]:
    kind = LaneKind(pool.kinds, pool.name if pool.is_shared else "", pool.seats)
    total = pool.gpus if pool.is_shared else 1
    ends = [
        None if any(held.ends_at is None for held in jobs) else max(map(_end, jobs))
        for jobs in together(pool, running)
        for _ in range(jobs[0].gpus if pool.is_shared else 1)
    ]
    for free_s in ends[:total] + [0.0] * (total - len(ends)):
        yield Lane(kind, free_s)
    part = replace(kind, is_part=True)
    for one in pool.shared.values():
        yield from (Lane(part, 0.0) for _ in range(one.seats))
    for held in running:
        if held.pool == pool.name and held.shares:
            yield Lane(part, None if held.ends_at is None else _end(held))


def _end(held: Held) -> float:
    return held.ends_at if held.ends_at is not None and held.ends_at > 0 else _OVERDUE_S


def _start(forecast: Forecast) -> float:
    return math.inf if forecast.starts_s is None else forecast.starts_s


def forecasts(
    requests: Sequence[Request], lanes: Sequence[Lane], standings: Standings, usual_s: float | None
) -> Mapping[str, Forecast]:
    """By the job's id. usual_s: the duration of a job of which nothing is expected. Changes the standings."""
    free = defaultdict[LaneKind, list[float]](list)
    for lane in lanes:
        insort(free[lane.kind], math.inf if lane.free_s is None else lane.free_s)
    limits = {request.who: standings.limit(request.who) for request in requests}
    started = Counter[LaneKind]()
    found = dict[str, Forecast]()
    for request in in_order(requests, standings):
        takes = {kind: kind.lanes_for(request) for kind in free if kind.takes(request)}
        able = [kind for kind, number in takes.items() if number <= len(free[kind])]
        before = sum(started[kind] for kind in able)
        if not able:
            found[request.id] = Forecast(before, None, "No worker takes jobs like it.")
            continue
        # Of two that are free, a part of a GPU that others share.
        first = min(able, key=lambda kind: (free[kind][takes[kind] - 1], not kind.is_part))
        number, ends = takes[first], free[first]
        starts_s = ends[number - 1]
        takes_s = request.expected_s if request.expected_s is not None else usual_s
        del ends[:number]
        for _ in range(number):
            insort(ends, math.inf if takes_s is None else starts_s + takes_s)
        if request.memory is not None and not first.is_part:  # Others may join it.
            for _ in range(first.seats - 1):
                insort(free[replace(first, is_part=True)], starts_s)
        slots = sum(len(free[kind]) // takes[kind] for kind in able)
        why = _why(request, before, slots, joins=first.is_part and starts_s == 0.0)
        found[request.id] = Forecast(before, starts_s if starts_s < math.inf else None, why)
        started[first] += 1
    for request in requests:
        if request.id not in found:
            # Some of theirs would start, and the rest after them.
            later = "It starts when others of its user or project have ended: their quota of running jobs."
            found[request.id] = Forecast(sum(started.values()), None, limits[request.who] or later)
    return found


def _why(request: Request, before: int, slots: int, *, joins: bool) -> str:
    """joins: whether it can start beside jobs that run."""
    shares = request.kind.endswith(_SHARED)
    if before:
        workers = "the one worker that takes" if slots == 1 else f"the {slots} workers that take"
        jobs = "1 job has its turn" if before == 1 else f"{before:,} jobs have their turn"
        return f"It is for {workers} jobs like it; {jobs} before it, by priority, recent use and age."
    if not shares:
        return "It is next: it starts when a worker that takes jobs like it is free."
    if request.memory is None:
        return "It is next: it has a GPU alone when one is free, since no job like it was measured yet."
    if joins:
        return f"It is next: it shares a GPU with others, of which it has {shown(request.memory)}."
    return f"It is next: it starts when a GPU is free, or a shared one has {shown(request.memory)} left."
