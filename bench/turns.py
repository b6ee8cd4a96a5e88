"""Months of 10,000 jobs of 50 users on 8 machines of 8 GPUs, under the policy of `core.jobs.turns` itself.

Ten users, one of each project, submit campaigns of 50 to 200 jobs, together more than half of the work; the
others a few jobs at a time. Everybody has more to do than an equal part of the GPUs, all together more than
twice what these can do. A job's duration is not known before: what is expected is the mean of its user's jobs
so far. Jain's index is that of the GPU-hours of all users in a week: 1 is equal, 1/50 is one who has it all.

Jobs run to their end here, and how long one takes is not known before. So one of 8 GPUs for 30 h gives its
user more than an equal part of a week, 215 GPU-hours, whatever the policy: the lowest week has two of them.
"""

import argparse
import math
import random
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from statistics import mean, median

from bench.summary import Figure, percentile
from core.jobs.turns import Held, Pool, Request, Standings, Who, choose, cost, decayed, in_order

_HOUR, _DAY = 3600.0, 86_400.0
_WEEK_S = 7 * _DAY
_MACHINES, _GPUS_EACH = 8, 8
_PROJECTS, _USERS_EACH = 10, 5
_SIZES, _SHARES = (1, 2, 4, 8), (0.60, 0.20, 0.12, 0.08)
_HALF_LIFE_S = 3 * _DAY
# Of a user with campaigns, as a multiple of another user's number of jobs.
_HEAVY = 5
# Of a job's duration.
_MEDIAN_H, _SIGMA = 4.0, 0.8


Weeks = list[dict[Who, float]]


@dataclass(frozen=True)
class Job:
    """A job as the simulation knows it, and the policy does not."""

    id: str
    who: Who
    gpus: int
    submitted_s: float
    takes_s: float


@dataclass
class Month:
    """What happened. got: GPU-seconds by week and user. waits: seconds by GPUs, of the jobs that started."""

    busy_s: float = 0.0
    got: Weeks = field(default_factory=list[dict[Who, float]])
    waits: dict[int, list[float]] = field(default_factory=lambda: {size: [] for size in _SIZES})
    started: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--picture", type=Path, metavar="FILE", help="where its picture goes")


def measure(arguments: argparse.Namespace) -> Iterator[Figure]:
    number, days, months = (600, 3, 1) if arguments.quick else (10_000, 28, 4)
    span_s = days * _DAY
    work = [workload(number, span_s, seed) for seed in range(months)]
    first, fair = ([simulate(jobs, span_s, policy) for jobs in work] for policy in (FirstCome, FairShare))
    yield from _figures("first come", first, at_most=0.6)
    yield from _figures("fair share", fair, at_least=0.95)
    whole = _MACHINES * _GPUS_EACH * span_s
    yield Figure("first come: GPUs busy", 100 * mean(month.busy_s for month in first) / whole, "%")
    parts = [mine.busy_s / others.busy_s for mine, others in zip(fair, first, strict=True)]
    yield Figure(
        "fair share: GPUs busy, of first come's", median(parts), "", min(parts), max(parts), at_least=0.95
    )
    if arguments.picture is not None:
        draw(first[0], fair[0], arguments.picture)


def _figures(
    name: str, months: Sequence[Month], *, at_most: float | None = None, at_least: float | None = None
) -> Iterator[Figure]:
    found = [jain(list(got.values())) for month in months for got in month.got]
    what = f"{name}: Jain's index of a week, median of {len(found)}"
    yield Figure(what, median(found), "", min(found), max(found), at_most, at_least)
    for size in _SIZES:
        waits = [wait for month in months for wait in month.waits[size]]
        yield Figure(f"{name}: wait of a job of {size} GPUs, median", median(waits) / _HOUR, "h")
        yield Figure(f"{name}: the same, 95th percentile", percentile(waits, 95) / _HOUR, "h")
    yield Figure(f"{name}: jobs started in a month", mean(month.started for month in months))


def workload(number: int, span_s: float, seed: int) -> list[Job]:
    """The jobs of all users in the order of their submission."""
    chance = random.Random(seed)
    users = [(f"p{project}", f"u{user}") for project in range(_PROJECTS) for user in range(_USERS_EACH)]
    shares = {who: _HEAVY if who[1] == "u0" else 1 for who in users}
    found = list[tuple[float, Who]]()
    for who, share in shares.items():
        left = number * share / sum(shares.values())
        at_s, every_s = 0.0, span_s / left
        while at_s < span_s:
            batch = chance.randint(50, 200) if share > 1 else chance.randint(1, 5)
            found += [(at_s, who)] * batch
            at_s += batch * every_s * chance.uniform(0.5, 1.5)
    found.sort()
    return [
        Job(
            id=f"{index:06d}",
            who=who,
            gpus=chance.choices(_SIZES, _SHARES)[0],
            submitted_s=at_s,
            takes_s=min(48.0, _MEDIAN_H * chance.lognormvariate(0, _SIGMA)) * _HOUR,
        )
        for index, (at_s, who) in enumerate(found[:number])
    ]


class FairShare:
    """The policy, given what the service has: the oldest job of each user and size, and decayed sums."""

    def __init__(self) -> None:
        self._waiting = defaultdict[tuple[Who, int], deque[Job]](deque)
        self._sums = dict[Who, tuple[float, float]]()
        self._took = defaultdict[Who, tuple[int, float]](lambda: (0, 0.0))

    def submit(self, job: Job) -> None:
        self._waiting[job.who, job.gpus].append(job)

    def next(self, offer: Pool, pools: Sequence[Pool], running: Mapping[str, Held], now: float) -> Job | None:
        use = {who: decayed(amount, at, now, _HALF_LIFE_S) for who, (amount, at) in self._sums.items()}
        held = list(running.values())
        heads = [self._request(queue[0]) for queue in self._waiting.values() if queue]
        found = choose(offer, in_order(heads, Standings(use, held, now=now)), pools, held, now)
        return None if found is None else self._waiting[found.who, found.gpus].popleft()

    def expected(self, job: Job) -> float | None:
        number, seconds = self._took[job.who]
        return seconds / number if number else None

    def end(self, job: Job, now: float) -> None:
        amount, at = self._sums.get(job.who, (0.0, now))
        used = cost(job.gpus, job.takes_s)
        self._sums[job.who] = (decayed(amount, at, now, _HALF_LIFE_S) + used, now)
        number, seconds = self._took[job.who]
        self._took[job.who] = number + 1, seconds + job.takes_s

    def _request(self, job: Job) -> Request:
        return Request(job.id, 1, job.who, job.gpus, self.expected(job))


class FirstCome(FairShare):
    """The oldest job that fits, whosever it is: no GPU idles that any job could take."""

    def __init__(self) -> None:
        super().__init__()
        self._by_size = {size: deque[Job]() for size in _SIZES}

    def submit(self, job: Job) -> None:
        self._by_size[job.gpus].append(job)

    def next(self, offer: Pool, pools: Sequence[Pool], running: Mapping[str, Held], now: float) -> Job | None:
        able = [queue for size, queue in self._by_size.items() if queue and size <= offer.free]
        return min(able, key=lambda queue: queue[0].id).popleft() if able else None


def simulate(jobs: Sequence[Job], span_s: float, policy: Callable[[], FairShare]) -> Month:
    """The jobs under a policy until `span_s`."""
    scheduler, month, numbers = policy(), Month(), count()
    events: list[tuple[float, int, Job, str]] = []
    for job in jobs:
        heappush(events, (job.submitted_s, next(numbers), job, ""))
    free = {f"machine {index}": _GPUS_EACH for index in range(_MACHINES)}
    running, spans = dict[str, Held](), list[tuple[Job, float, float]]()
    while events and (now := events[0][0]) < span_s:
        # What happens at one moment is known before a job starts: everybody's first jobs come at 0 s.
        while events and events[0][0] == now:
            _, _, job, machine = heappop(events)
            if machine:
                free[machine] += job.gpus
                del running[job.id]
                scheduler.end(job, now)
            else:
                scheduler.submit(job)
        for started, place in _starts(scheduler, free, running, now):
            expected = scheduler.expected(started)
            ends_at = None if expected is None else now + expected
            running[started.id] = Held(started.id, 1, started.who, started.gpus, now, ends_at, place)
            heappush(events, (now + started.takes_s, next(numbers), started, place))
            month.waits[started.gpus].append(now - started.submitted_s)
            spans.append((started, now, min(span_s, now + started.takes_s)))
    month.started = len(spans)
    month.busy_s = sum(job.gpus * (end - begin) for job, begin, end in spans)
    month.got = _by_weeks(spans, sorted({job.who for job in jobs}), span_s)
    return month


def _starts(
    scheduler: FairShare, free: dict[str, int], running: Mapping[str, Held], now: float
) -> Iterator[tuple[Job, str]]:
    """The fullest machine first, so that small jobs fill what others left."""
    refused = set[str]()
    while places := [name for name, number in free.items() if number and name not in refused]:
        place = min(places, key=lambda name: (free[name], name))
        pools = [Pool(name, _GPUS_EACH, number) for name, number in free.items()]
        offer = Pool(place, _GPUS_EACH, free[place])
        job = scheduler.next(offer, pools, running, now)
        if job is None:
            refused.add(place)
            continue
        free[place] -= job.gpus
        yield job, place


# ---- What the users got. ----------------------------------------------------------------------------------


def _by_weeks(spans: Sequence[tuple[Job, float, float]], users: Sequence[Who], span_s: float) -> Weeks:
    weeks: Weeks = [dict.fromkeys(users, 0.0) for _ in range(math.ceil(span_s / _WEEK_S))]
    for job, started, ended in spans:
        for week, got in enumerate(weeks):
            within = min(ended, (week + 1) * _WEEK_S) - max(started, week * _WEEK_S)
            got[job.who] += job.gpus * max(0.0, within)
    return weeks


def jain(parts: Sequence[float]) -> float:
    """(Σx)² / (n Σx²): Jain, Chiu, Hawe 1984, "A Quantitative Measure of Fairness", DEC-TR-301."""
    return sum(parts) ** 2 / (len(parts) * sum(part * part for part in parts))


def draw(first: Month, fair: Month, path: Path) -> None:
    """The GPU-hours of each user in the last whole week, and how long jobs of each size waited."""
    from matplotlib.figure import Figure as Plot

    plot = Plot(figsize=(10, 4), layout="constrained")
    shares, waits = plot.subplots(1, 2)
    for month, name in ((first, "first come, first served"), (fair, "fair share")):
        hours = sorted((seconds / _HOUR for seconds in month.got[-1].values()), reverse=True)
        shares.plot(range(1, len(hours) + 1), hours, label=f"{name}: Jain {jain(hours):.2f}")
        found = [median(month.waits[size]) / _HOUR for size in _SIZES]
        waits.plot([str(size) for size in _SIZES], found, marker="o", label=name)
    shares.set(title="GPU-hours in the last week", xlabel="user, by what they got", ylim=(0, None))
    waits.set(title="hours until a job starts, median", xlabel="GPUs of the job", ylim=(0, None))
    for axes in (shares, waits):
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False)
    plot.savefig(path, dpi=110)  # pyright: ignore[reportUnknownMemberType]
