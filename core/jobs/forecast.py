"""When a waiting job should start, how many are before it, and why it waits: an estimate. Pure."""

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heapreplace

from core.environments.info import Device
from core.jobs.pools import pools_of
from core.jobs.turns import Held, Pool, Quotas, Request, Share, Standings, Started, in_order, standings_on
from core.jobs.workers import WorkerInfo

# A job that has run for longer than usual ends in about so many seconds.
_OVERDUE_S = 60.0


@dataclass(frozen=True)
class TurnFacts:
    """What the record says of one moment. waiting: the oldest, with the kind of the slot that each needs."""

    waiting: Sequence[Request]
    started: Sequence[Started]
    shares: Sequence[Share]
    quotas: Quotas


@dataclass(frozen=True, slots=True)
class Lane:
    """A slot for one job at a time. kinds: of requests that it takes. free_s: in how many seconds it is free,
    an estimate; None where nobody knows."""

    kinds: frozenset[str]
    free_s: float | None


@dataclass(frozen=True, slots=True)
class Forecast:
    """before: how many jobs start before it in slots that it could have. starts_s: in how many seconds it
    should start, by measured durations; None without an estimate. reason: a sentence."""

    before: int
    starts_s: float | None
    reason: str


def forecasts_of(facts: TurnFacts, workers: Sequence[WorkerInfo]) -> Mapping[str, Forecast]:
    """By the job's id, if there is a worker for it; the earlier one of a GPU's and a CPU's."""
    found = dict[str, Forecast]()
    devices: Sequence[Device] = ("gpu", "cpu")
    for device in devices:
        standings, usual_s = standings_on(device, facts.shares, facts.started, facts.quotas)
        pools, running = pools_of(device, workers, facts.started, usual_s)
        lanes = [_lane(pool, running) for pool in pools]
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
    return found


def _lane(pool: Pool, running: Sequence[Held]) -> Lane:
    holds = next((held for held in running if held.pool == pool.name), None)
    if holds is None:
        return Lane(pool.kinds, 0.0)
    left_s = holds.ends_at
    return Lane(pool.kinds, left_s if left_s is None or left_s > 0 else _OVERDUE_S)


def _start(forecast: Forecast) -> float:
    return math.inf if forecast.starts_s is None else forecast.starts_s


def forecasts(
    requests: Sequence[Request], lanes: Sequence[Lane], standings: Standings, usual_s: float | None
) -> Mapping[str, Forecast]:
    """By the job's id. usual_s: the duration of a job of which nothing is expected. Changes the standings."""
    free = defaultdict[frozenset[str], list[float]](list)
    for lane in lanes:
        free[lane.kinds].append(math.inf if lane.free_s is None else lane.free_s)
    for ends in free.values():
        heapify(ends)
    limits = {request.who: standings.limit(request.who) for request in requests}
    started = Counter[frozenset[str]]()
    found = dict[str, Forecast]()
    for request in in_order(requests, standings):
        able = [kinds for kinds in free if request.kind in kinds]
        before = sum(started[kinds] for kinds in able)
        if not able:
            found[request.id] = Forecast(before, None, "No worker takes jobs like it.")
            continue
        kinds = min(able, key=lambda kinds: free[kinds][0])
        starts_s = free[kinds][0]
        takes_s = request.expected_s if request.expected_s is not None else usual_s
        heapreplace(free[kinds], math.inf if takes_s is None else starts_s + takes_s)
        slots = sum(len(free[kinds]) for kinds in able)
        found[request.id] = Forecast(before, starts_s if starts_s < math.inf else None, _why(before, slots))
        started[kinds] += 1
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
