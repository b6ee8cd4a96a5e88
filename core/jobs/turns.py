"""Whose turn it is: which waiting job a free slot takes, and what a job waits for. Pure: no clock, no store.

Higher priority comes first. Inside a priority the project comes first that has used least for its weight, in
it the user who has; and of one user's jobs the oldest. Use is GPU-seconds (a machine without GPUs: seconds),
halved every half-life. A job that runs counts at once with all that it is expected to use: otherwise a
hundred jobs of one user would all start before the first of them has used anything.

The first job in this order that fits nowhere has a machine kept for it, the one that will have room first.
Others pass it where they do not delay it: on other machines, on GPUs that it leaves over, or if they are
expected to end before (EASY backfill: Lifka 1995, "The ANL/IBM SP scheduling system").

Times are seconds of any one clock. Everything in here is a function of what is passed in: `bench turns` runs
a month of it.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from heapq import heapify, heappop, heapreplace

from core.jobs.spec import Priority

# A project and a user in it; the user is empty without accounts.
Who = tuple[str, str]
# The least for which a running job counts.
ADVANCE_S = 900.0
# The part of the pools that is kept for jobs which fit nowhere; at least one.
MOST_KEPT = 0.25
# What is expected of a job that has run for longer than expected: that it goes on for this long.
_OVERDUE_S = 60.0


@dataclass(frozen=True, slots=True)
class Request:
    """A waiting job. rank: 0 for the highest priority. gpus: 0 for one that takes a machine's CPU.

    expected_s: for how long such jobs have run; None where nothing was measured. kind: of the slot it needs.
    memory: the bytes of a GPU that a job needs which shares one; None for one that has its GPUs alone, as the
    first of its kind also has.
    """

    id: str
    rank: int
    who: Who
    gpus: int = 1
    expected_s: float | None = None
    kind: str = ""
    memory: int | None = None


@dataclass(frozen=True, slots=True)
class Held:
    """A running job, with what it holds of which pool. ends_at: an estimate; None without one.

    shares: the GPU that it shares; empty where it has its GPUs alone. part: of that GPU's memory; memory: the
    same in bytes. lost_s: the seconds of work that it would do again after a drain. is_preemptible: it said
    so itself. yields_to: the waiting job for which it drains; empty without one.
    """

    id: str
    rank: int
    who: Who
    gpus: int
    started_at: float
    ends_at: float | None = None
    pool: str = ""
    is_preemptible: bool = False
    lost_s: float = 0.0
    yields_to: str = ""
    shares: str = ""
    part: float = 1.0
    memory: int = 0


@dataclass(frozen=True, slots=True)
class SharedGpu:
    """What is left of a GPU that jobs share. seats: how many may join them; bytes: of its memory."""

    seats: int
    bytes: int


@dataclass(frozen=True, slots=True)
class Pool:
    """The GPUs of a machine that jobs share out among themselves (is_shared); or a slot for one job.

    kinds: of the requests that it takes; none: of any. free: how many GPUs no job holds. seats: how many jobs
    may share a GPU, and gpu_bytes: how much of its memory they have together; 0 where none may. shared: the
    GPUs that jobs share now, by their names.
    """

    name: str
    gpus: int
    free: int
    kinds: frozenset[str] = frozenset()
    is_shared: bool = False
    seats: int = 1
    gpu_bytes: int = 0
    shared: Mapping[str, SharedGpu] = field(default_factory=dict[str, SharedGpu])

    def could_hold(self, request: "Request") -> bool:
        """Once its jobs have ended."""
        return request.gpus <= self.gpus and (not self.kinds or request.kind in self.kinds)

    def has_room(self, request: "Request") -> bool:
        return self.could_hold(request) and (request.gpus <= self.free or self.joined(request) is not None)

    def may_share(self, request: "Request") -> bool:
        """Whether the job would have a part of a GPU here; otherwise it has one alone."""
        return request.memory is not None and request.memory <= self.gpu_bytes

    def joined(self, request: "Request") -> str | None:
        """The GPU on which it can join others: the fullest, so that large parts stay whole."""
        if request.memory is None:
            return None
        fitting = [
            (one.bytes, gpu)
            for gpu, one in self.shared.items()
            if one.seats > 0 and request.memory <= one.bytes
        ]
        return min(fitting)[1] if fitting else None

    def after_start(self, request: "Request") -> "Pool":
        """Once this job, for which there is room, runs here."""
        memory, gpu = request.memory or 0, self.joined(request)
        if gpu is not None:
            one = self.shared[gpu]
            return self._with(gpu, SharedGpu(one.seats - 1, one.bytes - memory))
        taken = replace(self, free=self.free - request.gpus)
        if not self.may_share(request):
            return taken
        return taken._with(f"of {request.id}", SharedGpu(self.seats - 1, self.gpu_bytes - memory))

    def after_end(self, held: Held) -> "Pool":
        """Once this running job has ended."""
        one = self.shared.get(held.shares)
        if one is None:
            return replace(self, free=self.free + held.gpus)
        left = SharedGpu(one.seats + 1, one.bytes + held.memory)
        if left.bytes < self.gpu_bytes:
            return self._with(held.shares, left)
        others = {gpu: one for gpu, one in self.shared.items() if gpu != held.shares}
        return replace(self, free=self.free + 1, shared=others)

    def _with(self, gpu: str, left: SharedGpu) -> "Pool":
        return replace(self, shared={**self.shared, gpu: left})


@dataclass(frozen=True, slots=True)
class Quota:
    """What an administrator allows a user, or a project. weight: of its share. running: jobs at once.

    The others are checked when a job is submitted: queued jobs, GPU-hours of a week, bytes stored, and the
    highest priority that it may have.
    """

    weight: float = 1.0
    running: int | None = None
    queued: int | None = None
    gpu_hours: float | None = None
    bytes: int | None = None
    highest_priority: Priority = "high"


NO_QUOTA = Quota()


@dataclass(frozen=True, slots=True)
class Quotas:
    """Those that were set, by the kind (`user` or `project`) and the name."""

    by_party: Mapping[tuple[str, str], Quota]

    def of(self, kind: str, name: str) -> Quota:
        return self.by_party.get((kind, name), NO_QUOTA)


NO_QUOTAS = Quotas({})


def parties(who: Who) -> Sequence[tuple[str, str]]:
    """Whose quotas a job counts for."""
    return (("user", who[1]), ("project", who[0]))


def decayed(amount: float, at: float, now: float, half_life_s: float) -> float:
    """What is left of an amount that was true at a moment. A moment ahead is now: a clock was set."""
    return amount * 2.0 ** (-max(0.0, now - at) / half_life_s)


def cost(gpus: int, seconds: float) -> float:
    """What a job uses in this time: GPU-seconds, or a CPU's seconds."""
    return max(1, gpus) * seconds


# ---- The order. -------------------------------------------------------------------------------------------


class Standings:
    """Who has used how much for their weight, and how many of whose jobs run.

    use: decayed, of attempts that have ended. elsewhere: those with a job on devices of another kind, which
    counts for quotas alone.
    """

    def __init__(
        self,
        use: Mapping[Who, float],
        running: Iterable[Held] = (),
        *,
        elsewhere: Iterable[Who] = (),
        quotas: Quotas = NO_QUOTAS,
        now: float = 0.0,
    ) -> None:
        self._quotas = quotas
        self._of_user, self._of_project = defaultdict[Who, float](float), defaultdict[str, float](float)
        self._running = Counter[tuple[str, str]]()
        for who, amount in use.items():
            self._add(who, amount)
        for held in running:
            self._add(held.who, _counted(held, now))
            self._count(held.who)
        for who in elsewhere:
            self._count(who)

    def start(self, request: Request) -> None:
        """Count a job that starts now."""
        self._add(request.who, cost(request.gpus, max(ADVANCE_S, request.expected_s or 0.0)))
        self._count(request.who)

    def end(self, held: Held, now: float) -> None:
        """Count a running job with what it has used, since it ends now."""
        self._add(held.who, _used(held, now) - _counted(held, now))
        self._running.subtract(parties(held.who))

    def key(self, request: Request) -> tuple[int, float, float, str]:
        """The request with the smallest one has the turn. No key becomes smaller when a job starts."""
        return (request.rank, *self.place(request.who), request.id)

    def place(
        self, who: Who, ended: Iterable[Held] = (), more: tuple[Who, float] | None = None, now: float = 0.0
    ) -> tuple[float, float]:
        """What the project and the user have used for their weights: fewer come first.

        As if these running jobs had ended, and one user had used so much more.
        """
        project, user = who
        of_project, of_user = self._of_project[project], self._of_user[who]
        changes = [(held.who, _used(held, now) - _counted(held, now)) for held in ended]
        for whose, use in changes if more is None else [*changes, more]:
            of_project += use if whose[0] == project else 0.0
            of_user += use if whose == who else 0.0
        return (
            _for_weight(of_project, self._quotas.of("project", project).weight),
            _for_weight(of_user, self._quotas.of("user", user).weight),
        )

    def limit(self, who: Who) -> str | None:
        """A sentence if as many of their jobs run as may; None if another one may start."""
        for kind, name in parties(who):
            most, number = self._quotas.of(kind, name).running, self._running[kind, name]
            if most == 0:
                return f"The {kind} {name} may run nothing: its quota of running jobs is 0."
            if most is not None and number >= most:
                return (
                    f"{number} jobs of the {kind} {name} run, and its quota is {most}: one has to end first."
                )
        return None

    def _add(self, who: Who, amount: float) -> None:
        self._of_user[who] += amount
        self._of_project[who[0]] += amount

    def _count(self, who: Who) -> None:
        for party in parties(who):
            self._running[party] += 1


def _counted(held: Held, now: float) -> float:
    """As what a running job counts: all that it is expected to use."""
    until = now if held.ends_at is None else max(now, held.ends_at)
    return held.part * cost(held.gpus, max(ADVANCE_S, until - held.started_at))


def _used(held: Held, now: float) -> float:
    return held.part * cost(held.gpus, now - held.started_at)


def _for_weight(use: float, weight: float) -> float:
    """Nothing comes after a weight of 0."""
    return use / weight if weight > 0 else math.inf


def in_order(requests: Iterable[Request], standings: Standings) -> Iterator[Request]:
    """The requests in their turns, if each one starts before the next is chosen.

    Leaves out those whom a quota holds back until a job ends. Changes the standings.
    """
    waiting = defaultdict[tuple[int, Who], list[Request]](list)
    for request in requests:
        waiting[request.rank, request.who].append(request)
    for queue in waiting.values():
        queue.sort(key=lambda request: request.id, reverse=True)
    heads = [(standings.key(queue[-1]), group) for group, queue in waiting.items()]
    heapify(heads)
    while heads:
        said, group = heads[0]
        request = waiting[group][-1]
        now = standings.key(request)
        if standings.limit(request.who) is not None:
            heappop(heads)
        elif now != said:  # Others of its project have started; keys only grow.
            heapreplace(heads, (now, group))
        else:
            waiting[group].pop()
            yield request
            standings.start(request)
            if waiting[group]:
                heapreplace(heads, (standings.key(waiting[group][-1]), group))
            else:
                heappop(heads)


@dataclass(frozen=True, slots=True)
class Share:
    """What a user has used in a project of late. usual_s: how long an attempt of theirs takes, on average."""

    device: str
    who: Who
    amount: float
    usual_s: float


@dataclass(frozen=True, slots=True)
class Started:
    """A running attempt, as the record has it. device: `gpu` or `cpu`; age_s: since its start.

    worker: its name. rank, is_preemptible, yields_to: as in `Request` and `Held`. part: of its GPU's memory,
    where it shares the GPU.
    """

    id: str
    who: Who
    device: str
    gpus: int
    age_s: float
    worker: str = ""
    rank: int = 0
    is_preemptible: bool = False
    yields_to: str = ""
    part: float | None = None


@dataclass(frozen=True)
class TurnFacts:
    """What the record says of one moment. waiting: the oldest, with the kind of the slot that each needs."""

    waiting: Sequence[Request]
    started: Sequence[Started]
    shares: Sequence[Share]
    quotas: Quotas


def held_of(one: Started, usual_s: Mapping[Who, float]) -> Held:
    """What it holds of its worker's pool, if now is 0 s. usual_s: how long attempts of its user take."""
    expected_s = usual_s.get(one.who)
    return Held(
        one.id,
        one.rank,
        one.who,
        one.gpus,
        started_at=-one.age_s,
        ends_at=None if expected_s is None else expected_s - one.age_s,
        pool=one.worker,
        is_preemptible=one.is_preemptible,
        yields_to=one.yields_to,
        part=1.0 if one.part is None else one.part,
    )


def standings_on(
    device: str, shares: Iterable[Share], started: Iterable[Started], quotas: Quotas
) -> tuple[Standings, Mapping[Who, float]]:
    """Those among the users of this kind of device, and how long their attempts take."""
    own = [share for share in shares if share.device == device]
    usual_s = {share.who: share.usual_s for share in own}
    held = [held_of(one, usual_s) for one in started if one.device == device]
    others = [one.who for one in started if one.device != device]
    use = {share.who: share.amount for share in own}
    return Standings(use, held, elsewhere=others, quotas=quotas), usual_s


# ---- Which one a pool takes, and what is kept for whom. ---------------------------------------------------


@dataclass(frozen=True, slots=True)
class Reservation:
    """A pool that is kept for the first job that fits nowhere.

    from_s: when it has room, by what is expected. spare: GPUs that it will have beyond the job's.
    """

    request: Request
    pool: str
    from_s: float
    spare: int


def choose(
    offer: Pool, ordered: Iterable[Request], pools: Sequence[Pool], running: Sequence[Held], now: float
) -> Request | None:
    """The job that this pool takes now; None if none fits, or only such as would delay the first in turn.

    ordered: as `in_order` has them. pools: all, with the offer. running: what these pools hold. Where jobs
    drain for a waiting one, their pool is kept for it: otherwise they would take back what they have left.
    """
    kept = dict[str, Reservation]()
    drained = {held.pool: held.yields_to for held in running if held.yields_to}
    left = max(1, int(MOST_KEPT * len(pools)))
    for request in ordered:
        if offer.has_room(request) and not _delays(request, offer, kept, now):
            return request
        others = [pool for pool in pools if pool.name not in kept]
        if any(pool.has_room(request) for pool in others):
            continue
        own = [pool for pool in others if drained.get(pool.name) == request.id]
        if not own and left == 0:
            continue
        found = reserve(request, own or [pool for pool in others if pool.name not in drained], running, now)
        if found is not None:
            kept[found.pool] = found
            left -= 0 if own else 1
    return None


def reserve(
    request: Request, pools: Sequence[Pool], running: Sequence[Held], now: float
) -> Reservation | None:
    """The pool that will have room for the job first; None if it is too large for all of them."""
    found = [
        Reservation(request, pool.name, *_room(request, pool, running, now))
        for pool in pools
        if pool.could_hold(request)
    ]
    # Of several without an estimate, the one that is emptiest now; last one with a GPU that no job frees.
    free = {pool.name: pool.free for pool in pools}
    return min(found, key=lambda one: (one.from_s, one.spare < 0, -free[one.pool], one.pool), default=None)


def _room(request: Request, pool: Pool, running: Sequence[Held], now: float) -> tuple[float, int]:
    """When the pool has room for the job, and how many GPUs it has then beyond."""
    free, moment = pool.free, now
    for ends_at, freed in sorted(
        (max(_end(held, now) for held in group), group[0].gpus) for group in together(pool, running)
    ):
        if free >= request.gpus:
            break
        free, moment = free + freed, ends_at
    # A process that is no job's may hold a GPU.
    alone_at = moment if free >= request.gpus else math.inf
    joins_at = min((_end(held, now) for held in _in_the_way(request, pool, running)), default=math.inf)
    return (joins_at, pool.free) if joins_at < alone_at else (alone_at, free - request.gpus)


def together(pool: Pool, running: Sequence[Held]) -> Sequence[Sequence[Held]]:
    """The jobs of this pool: those that share a GPU, which is free when all of them have ended, as one."""
    groups = defaultdict[str, list[Held]](list)
    for held in running:
        if held.pool == pool.name:
            groups[held.shares or held.id].append(held)
    return list(groups.values())


def _in_the_way(request: Request, pool: Pool, running: Sequence[Held]) -> Sequence[Held]:
    """The jobs of which one would have to end for the request to join the others on its GPU."""
    if not pool.may_share(request) or request.memory is None:
        return []
    enough = {gpu: request.memory - one.bytes for gpu, one in pool.shared.items()}
    sharing = [held for held in running if held.pool == pool.name and held.shares in enough]
    return [held for held in sharing if held.memory >= enough[held.shares]]


def _end(held: Held, now: float) -> float:
    if held.yields_to:
        return now
    if held.ends_at is None:
        return math.inf
    return held.ends_at if held.ends_at > now else now + _OVERDUE_S


def _delays(request: Request, offer: Pool, kept: Mapping[str, Reservation], now: float) -> bool:
    """Whether it would delay the job for which the pool is kept."""
    here = kept.get(offer.name)
    if here is None or request.gpus <= here.spare:
        return False
    return request.expected_s is None or now + request.expected_s > here.from_s


def to_drain(request: Request, pools: Sequence[Pool], running: Sequence[Held]) -> Sequence[Held]:
    """The running jobs that would make room for this one: of one pool, and those that lose least by it.

    Only jobs of lower priority, and of the same one those that said that they are preemptible, and are
    another user's. Empty if that makes no room, or there is room.
    """
    if any(pool.has_room(request) for pool in pools):
        return []
    found = [_victims(request, pool, running) for pool in pools if pool.could_hold(request)]
    return min(filter(None, found), key=_loss, default=list[Held]())


def _victims(request: Request, pool: Pool, running: Sequence[Held]) -> list[Held]:
    one = [[held] for held in _in_the_way(request, pool, running) if may_yield(held, request)]
    if one:
        return list(min(one, key=_loss))
    may = [group for group in together(pool, running) if all(may_yield(held, request) for held in group)]
    may.sort(key=lambda group: (_loss(group), group[0].id))
    chosen, free = list[Sequence[Held]](), pool.free
    for group in may:
        if free < request.gpus:
            chosen.append(group)
            free += group[0].gpus
    if free < request.gpus:
        return []
    for group in sorted(chosen, key=lambda group: _loss(group)[1], reverse=True):
        if free - group[0].gpus >= request.gpus:  # Those after it were enough.
            chosen.remove(group)
            free -= group[0].gpus
    return [held for group in chosen for held in group]


def may_yield(held: Held, request: Request) -> bool:
    """Whether the job may have to make room for this one."""
    is_preemptible = held.is_preemptible and held.rank == request.rank and held.who != request.who
    return held.rank > request.rank or is_preemptible


def _loss(victims: Sequence[Held]) -> tuple[int, float]:
    """The most urgent victim, and the GPU-seconds that all of them do again."""
    return -min(held.rank for held in victims), sum(held.lost_s * held.gpus for held in victims)
