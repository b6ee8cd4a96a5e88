"""Which running jobs make room for which waiting ones. Pure: `core.jobs.turns` says who has the turn.

A waiting job gets room if its turn has come and no slot that could run it is free. It then names trainings of
lower priority; or such of its own priority that said that they are preemptible, and whose user would come
after it: by the standings that the claim of the slot will have, once they have ended. These have run for a
while, and it stays ahead of them for a while, so that two users who have used about the same do not take a
slot from each other again and again.

A rollout makes room for nobody: it would begin anew, and lose what it has done.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from core.environments.info import Device
from core.jobs.pools import pools_of
from core.jobs.turns import (
    Held,
    Pool,
    Request,
    Standings,
    Started,
    TurnFacts,
    Who,
    cost,
    in_order,
    may_yield,
    standings_on,
    to_drain,
)
from core.jobs.workers import WorkerInfo

# For a job of the same priority, no attempt is drained that has run for less: it has hardly compiled.
LEAST_RUN_S = 60.0
# A job of the same priority stays ahead though it has run for so long.
HEAD_START_S = 300.0
# So long after the last ones, no others are asked for a waiting job: what they left may be taken by another.
ASKED_AGAIN_S = 30.0
# What has not drained by then never will: its worker is of an older version, and does not hear of it.
DRAINED_WITHIN_S = 600.0
# How many waiting jobs are compared with the workers at one look: each is read from the record.
_MOST_LOOKED_AT = 100


@dataclass(frozen=True)
class Holders:
    """What the record says of one moment. facts: of those that wait, the oldest of each user.

    movable: the running trainings that could make room, by their ids. drains: those that do, each with the
    job for which. asked: the waiting jobs for which others were asked a moment ago.
    """

    facts: TurnFacts
    movable: Collection[str]
    drains: Mapping[str, str]
    asked: Collection[str] = ()


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
    facts = holders.facts
    found = dict[str, Sequence[str]]()
    sides = [_side("gpu", facts, workers), _side("cpu", facts, workers)]
    soon, movable, num_looked_at = _Soon(sides, facts.waiting, holders.drains), set(holders.movable), 0
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
            if request.id in soon.settled or _group(request) in hopeless:
                continue
            could = {name: pool for name, pool in soon.pools.items() if pool.could_hold(request)}
            may = [held for held in side.held if held.id in movable and may_yield(held, request)]
            if not _is_hopeful(request, list(could.values()), may, side.claims):
                hopeless.add(_group(request))
                continue
            num_looked_at += 1
            if num_looked_at > _MOST_LOOKED_AT:
                break
            fitting = [could[name] for name in sorted(could.keys() & able(request))]
            taken = next((pool.name for pool in fitting if pool.has_room(request)), None)
            if taken is None:
                was_asked = request.id in holders.asked
                victims = list[Held]() if was_asked else _victims(request, fitting, may, side.claims)
                if not victims:
                    continue
                found[request.id] = [held.id for held in victims]
                movable -= {held.id for held in victims}
                taken = victims[0].pool
                for held in victims:
                    soon.end(held)
            soon.start(request, taken)
    return found


def _group(request: Request) -> tuple[Who, int, str]:
    return request.who, request.rank, request.kind


@dataclass(frozen=True)
class _Side:
    """The workers with one kind of device. standings: for the order of those that wait.

    claims: those of the next claims, see `_Soon`. usual_s: how long an attempt of a user takes.
    """

    pools: Sequence[Pool]
    held: Sequence[Held]
    standings: Standings
    claims: Standings
    usual_s: Mapping[Who, float]


class _Soon:
    """What the next claims find, when the jobs that drain have ended, and those that have room have started.

    settled: the waiting jobs with room.
    """

    def __init__(self, sides: Sequence[_Side], waiting: Sequence[Request], drains: Mapping[str, str]) -> None:
        self._homes = {pool.name: side for side in sides for pool in side.pools}
        self.pools = {pool.name: pool for side in sides for pool in side.pools}
        self.settled = set[str]()
        # What drains for a job that was cancelled meanwhile, or got another slot, is free for the others.
        by_id = {request.id: request for request in waiting}
        for held in (held for side in sides for held in side.held if held.id in drains):
            self.end(held)
            if (waits := by_id.get(drains[held.id])) is not None and waits.id not in self.settled:
                self.start(waits, held.pool)
        self.settled |= set(drains.values())

    def end(self, held: Held) -> None:
        self._homes[held.pool].claims.end(held, 0.0)
        self.pools[held.pool] = self.pools[held.pool].after_end(held)

    def start(self, request: Request, pool: str) -> None:
        side = self._homes[pool]
        side.claims.start(replace(request, expected_s=side.usual_s.get(request.who)))
        self.pools[pool] = self.pools[pool].after_start(request)
        self.settled.add(request.id)


def _side(device: Device, facts: TurnFacts, workers: Sequence[WorkerInfo]) -> _Side:
    standings, usual_s = standings_on(device, facts.shares, facts.started, facts.quotas)
    claims, _ = standings_on(device, facts.shares, facts.started, facts.quotas)
    pools, held = pools_of(device, workers, facts.started, usual_s)
    return _Side(pools, held, standings, claims, usual_s)


def _is_hopeful(request: Request, pools: Sequence[Pool], running: Sequence[Held], claims: Standings) -> bool:
    """Whether there is room, or somebody would make some, if all of these pools could run it."""
    return any(pool.has_room(request) for pool in pools) or bool(_victims(request, pools, running, claims))


def _victims(
    request: Request, pools: Sequence[Pool], running: Sequence[Held], claims: Standings
) -> Sequence[Held]:
    """Those that make room for it, if all that run would otherwise go on. Now is 0 s."""

    def come_after(victims: Sequence[Held]) -> bool:
        """Whether the claims of what they leave have them after the request, for a while."""
        start = (request.who, cost(request.gpus, HEAD_START_S))
        own = claims.place(request.who, victims, start)
        peers = {held.who for held in victims if held.rank == request.rank}
        return all(own < claims.place(who, victims, start) for who in peers)

    def may(held: Held) -> bool:
        return held.rank != request.rank or (-held.started_at >= LEAST_RUN_S and come_after([held]))

    victims = to_drain(request, pools, [held for held in running if may(held)])
    return victims if come_after(victims) else []
