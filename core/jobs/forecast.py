"""When a waiting job should start, how many are before it, and why it waits: an estimate. Pure."""

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heapreplace

from core.jobs.turns import Request, Standings, in_order


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


def forecasts(
    requests: Sequence[Request], lanes: Sequence[Lane], standings: Standings, usual_s: float | None
) -> Mapping[str, Forecast]:
    """By the job's id. usual_s: the duration of a job of which nothing is expected. Changes the standings."""
    free = defaultdict[frozenset[str], list[float]](list)
    for lane in lanes:
        free[lane.kinds].append(math.inf if lane.free_s is None else lane.free_s)
    for ends in free.values():
        heapify(ends)
    started = Counter[frozenset[str]]()
    found = dict[str, Forecast]()
    for request in in_order(requests, standings):
        able = [kinds for kinds in free if request.kind in kinds]
        before = sum(started[kinds] for kinds in able)
        if not able:
            found[request.id] = Forecast(before, None, "No slot of its kind is there.")
            continue
        kinds = min(able, key=lambda kinds: free[kinds][0])
        starts_s = free[kinds][0]
        takes_s = request.expected_s if request.expected_s is not None else usual_s
        heapreplace(free[kinds], math.inf if takes_s is None else starts_s + takes_s)
        number = sum(len(free[kinds]) for kinds in able)
        found[request.id] = Forecast(before, starts_s if starts_s < math.inf else None, _why(before, number))
        started[kinds] += 1
    for request in requests:
        if request.id not in found:
            limit = standings.limit(request.who)
            found[request.id] = Forecast(0, None, limit or "A quota of running jobs holds it back.")
    return found


def _why(before: int, slots: int) -> str:
    busy = (
        "The one slot that could take it is busy"
        if slots == 1
        else f"All {slots} slots that could take it are busy"
    )
    if not before:
        return f"It is next. {busy}, or one is taking it now."
    jobs = "1 job has its turn" if before == 1 else f"{before:,} jobs have their turn"
    return f"{busy}, and {jobs} before it: by priority, by who has used least of late, and by age."
