"""When a waiting job should start, how many are before it, and why it waits: an estimate. Pure."""

import math
from bisect import insort
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from core.environments.info import Device
from core.jobs.pools import pools_of
from core.jobs.turns import Held, Pool, Request, Standings, TurnFacts, in_order, standings_on
from core.jobs.workers import WorkerInfo

# A job that has run for longer than usual ends in about so many seconds.
_OVERDUE_S = 60.0
# In which time a job that makes room has kept its checkpoint and ended, if its epochs are short.
_DRAIN_S = 15.0
# Lanes of which it does not matter which one a job takes: their kinds and pool.
_Alike = tuple[frozenset[str], str]


@dataclass(frozen=True, slots=True)
class Lane:
    """A slot for one job at a time, or a GPU of a pool. kinds: of requests that it takes. free_s: in how many
    seconds it is free, an estimate; None where nobody knows. pool: its name, if a job takes a lane a GPU."""

    kinds: frozenset[str]
    free_s: float | None
    pool: str = ""


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
        kinds = frozenset[str]().union(*(lane.kinds for lane in lanes))
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
    name, total = (pool.name, pool.gpus) if pool.is_shared else ("", 1)
    ends = [
        held.ends_at if held.ends_at is None or held.ends_at > 0 else _OVERDUE_S
        for held in running
        if held.pool == pool.name
        for _ in range(held.gpus if pool.is_shared else 1)
    ]
    for free_s in ends[:total] + [0.0] * (total - len(ends)):
        yield Lane(pool.kinds, free_s, name)


def _start(forecast: Forecast) -> float:
    return math.inf if forecast.starts_s is None else forecast.starts_s


def forecasts(
    requests: Sequence[Request], lanes: Sequence[Lane], standings: Standings, usual_s: float | None
) -> Mapping[str, Forecast]:
    """By the job's id. usual_s: the duration of a job of which nothing is expected. Changes the standings."""
    free = defaultdict[_Alike, list[float]](list)
    for lane in lanes:
        insort(free[lane.kinds, lane.pool], math.inf if lane.free_s is None else lane.free_s)
    limits = {request.who: standings.limit(request.who) for request in requests}
    started = Counter[_Alike]()
    found = dict[str, Forecast]()
    for request in in_order(requests, standings):
        takes = {alike: request.gpus if alike[1] else 1 for alike in free if request.kind in alike[0]}
        able = [alike for alike, number in takes.items() if number <= len(free[alike])]
        before = sum(started[alike] for alike in able)
        if not able:
            found[request.id] = Forecast(before, None, "No worker takes jobs like it.")
            continue
        first = min(able, key=lambda alike: free[alike][takes[alike] - 1])
        number, ends = takes[first], free[first]
        starts_s = ends[number - 1]
        takes_s = request.expected_s if request.expected_s is not None else usual_s
        del ends[:number]
        for _ in range(number):
            insort(ends, math.inf if takes_s is None else starts_s + takes_s)
        slots = sum(len(free[alike]) // takes[alike] for alike in able)
        found[request.id] = Forecast(before, starts_s if starts_s < math.inf else None, _why(before, slots))
        started[first] += 1
    for request in requests:
        if request.id not in found:
            # Some of theirs would start, and the rest after them.
            later = "It starts when others of its user or project have ended: their quota of running jobs."
            found[request.id] = Forecast(sum(started.values()), None, limits[request.who] or later)
    return found


def _why(before: int, slots: int) -> str:
    if not before:
        return "It is next: it starts when a worker that takes jobs like it is free."
    workers = "the one worker that takes" if slots == 1 else f"the {slots} workers that take"
    jobs = "1 job has its turn" if before == 1 else f"{before:,} jobs have their turn"
    return f"It is for {workers} jobs like it; {jobs} before it, by priority, recent use and age."
