"""Which running jobs make room for which waiting ones. Pure: `core.jobs.turns` says who has the turn.

A waiting job gets room if its turn has come and no slot that could run it is free. It then names trainings of
lower priority; or such of its own priority that said that they are preemptible, and whose user would come
after it. These have run for a while, and it stays ahead of them for a while, so that two users who have used
about the same do not take a slot from each other again and again.

A rollout makes room for nobody: it would begin anew, and lose what it has done.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from core.environments.info import Device
from core.jobs.pools import pools_of
from core.jobs.turns import (
    Held,
    Pool,
    Quotas,
    Request,
    Standings,
    Started,
    TurnFacts,
    Who,
    cost,
    in_order,
    standings_on,
    to_drain,
)
from core.jobs.workers import WorkerInfo

# For a job of the same priority, no attempt is drained that has run for less: it has hardly compiled.
LEAST_RUN_S = 60.0
# A job of the same priority stays ahead though it has run for so long.
HEAD_START_S = 300.0
# How many waiting jobs are compared with the workers at one look: each is read from the record.
_MOST_LOOKED_AT = 100


@dataclass(frozen=True)
class Holders:
    """What the record says of one moment. facts: of those that wait, the oldest of each user.

    movable: the running trainings that could make room, by their ids. drains: those that do, each with the
    job for which.
    """

    facts: TurnFacts
    movable: Collection[str]
    drains: Mapping[str, str]


def may_be_asked(started: Sequence[Started], movable: Collection[str], rank: int) -> bool:
    """Whether one of these may have to make room for a job of this rank."""
    return any(
        one.rank > rank or (one.rank == rank and one.is_preemptible) for one in started if one.id in movable
    )


def making_room(
    holders: Holders, workers: Sequence[WorkerInfo], able: Callable[[Request], Collection[str]]
) -> Mapping[str, Sequence[str]]:
    """By the waiting job's id those that are to drain for it.

    able: the names of the pools that could run the job; asked of few, since it reads the job.
    """
    facts, drains = holders.facts, holders.drains
    found = dict[str, Sequence[str]]()
    sides = [_side("gpu", facts, workers), _side("cpu", facts, workers)]
    settled, movable, num_looked_at = set(drains.values()), set(holders.movable), 0
    # What drains for a job that was cancelled meanwhile, or got another slot, is free in a moment.
    waiting = {request.id for request in facts.waiting}
    unclaimed = [job for job, waits in drains.items() if waits not in waiting]
    pools = {pool.name: _without(unclaimed, pool, side.held) for side in sides for pool in side.pools}
    for side in sides:
        # Whose jobs of which kind get nothing now: those behind their first are not compared, either.
        hopeless = set[tuple[Who, int, str]]()
        kinds = frozenset[str]().union(*(pool.kinds for pool in side.pools))
        requests = [request for request in facts.waiting if request.kind in kinds]
        groups = {_group(request) for request in requests}
        for request in in_order(requests, side.standings):
            if hopeless == groups:
                break
            # What is settled could also run on the other kind of device.
            if request.id in settled or _group(request) in hopeless:
                continue
            could = {name: pool for name, pool in pools.items() if pool.could_hold(request)}
            may = [held for held in side.held if held.id in movable and held.pool in could]
            if not _is_hopeful(request, list(could.values()), may, side.spent, facts.quotas):
                hopeless.add(_group(request))
                continue
            num_looked_at += 1
            if num_looked_at > _MOST_LOOKED_AT:
                break
            fitting = [could[name] for name in sorted(could.keys() & able(request))]
            taken = next((pool.name for pool in fitting if pool.has_room(request)), None)
            if taken is None:
                victims = _victims(request, fitting, may, side.spent, facts.quotas)
                if not victims:
                    continue
                found[request.id] = [held.id for held in victims]
                movable -= {held.id for held in victims}
                taken = victims[0].pool
                pools[taken] = _without(found[request.id], pools[taken], victims)
            pools[taken] = replace(pools[taken], free=pools[taken].free - request.gpus)
            settled.add(request.id)
    return found


def _group(request: Request) -> tuple[Who, int, str]:
    return request.who, request.rank, request.kind


@dataclass(frozen=True)
class _Side:
    """The workers with one kind of device. spent: what each user has used of them until now."""

    pools: Sequence[Pool]
    held: Sequence[Held]
    standings: Standings
    spent: Mapping[Who, float]


def _without(jobs: Collection[str], pool: Pool, running: Sequence[Held]) -> Pool:
    """The pool once these of its jobs have ended."""
    freed = sum(held.gpus for held in running if held.id in jobs and held.pool == pool.name)
    return replace(pool, free=pool.free + freed)


def _side(device: Device, facts: TurnFacts, workers: Sequence[WorkerInfo]) -> _Side:
    standings, usual_s = standings_on(device, facts.shares, facts.started, facts.quotas)
    pools, held = pools_of(device, workers, facts.started, usual_s)
    spent = defaultdict[Who, float](float)
    for share in facts.shares:
        if share.device == device:
            spent[share.who] += share.amount
    for one in facts.started:
        if one.device == device:
            spent[one.who] += cost(one.gpus, one.age_s)
    return _Side(pools, held, standings, spent)


def _is_hopeful(
    request: Request,
    pools: Sequence[Pool],
    running: Sequence[Held],
    spent: Mapping[Who, float],
    quotas: Quotas,
) -> bool:
    """Whether there is room, or somebody would make some, if all of these pools could run it."""
    return any(pool.has_room(request) for pool in pools) or bool(
        _victims(request, pools, running, spent, quotas)
    )


def _victims(
    request: Request,
    pools: Sequence[Pool],
    running: Sequence[Held],
    spent: Mapping[Who, float],
    quotas: Quotas,
) -> Sequence[Held]:
    """Those that make room for it, if all that run would otherwise go on. Now is 0 s."""
    ahead = dict(spent)
    ahead[request.who] = ahead.get(request.who, 0.0) + cost(request.gpus, HEAD_START_S)
    turns = Standings(ahead, quotas=quotas)
    _, *own, _ = turns.key(request)

    def may(held: Held) -> bool:
        if held.rank != request.rank:
            return True
        _, *others, _ = turns.key(Request(held.id, held.rank, held.who, held.gpus))
        return -held.started_at >= LEAST_RUN_S and own < others

    return to_drain(request, pools, [held for held in running if may(held)])
