"""Whose turn it is, decided where a job is claimed.

A claim passes a job by that another one is about to take, and counts it as started: claims do not wait for
each other, and need no transaction beyond the statement that writes one. Where somebody has a quota of
running jobs they wait, each for the whole of the one before, so that it is exact.
`core.jobs.turns` decides. It is told of the oldest waiting job of each queue and user, which an index has, so
that a claim takes as long among ten thousand jobs as among ten.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from functools import cache, partial
from typing import Any

from sqlalchemy import Connection, TextClause, text

from core.adapters.postgres.engine import DriverStatement, Session
from core.adapters.postgres.quotas import quotas_of
from core.adapters.postgres.rows import HELD, Values, columns, find_job, readable
from core.adapters.postgres.saving import claim_job
from core.adapters.postgres.usage import SHARES
from core.errors import IllegalTransition, JobNotFound, StaleJob
from core.jobs.job import Job
from core.jobs.pools import GIVEN, NothingFits, Offer, choose_for
from core.jobs.preemption import DRAINED_WITHIN_S
from core.jobs.queue import PRIORITIES
from core.jobs.sharing import share_for
from core.jobs.slots import kind_of_queue
from core.jobs.turns import Request, Share, Standings, Started, TurnFacts, Who, in_order, standings_on

# Without sorting, PostgreSQL walks the index `jobs_turns` also where it has no statistics yet. Planning anew
# for each claim would take half of its time.
_PLAN = (
    "SELECT set_config('enable_sort', 'off', true), set_config('plan_cache_mode', 'force_generic_plan', true)"
)
# An arbitrary number of ours: who comes second waits until the first one's transaction has ended.
_ALONE = text("SELECT pg_advisory_xact_lock(7310582061)")
# As `leases._is_due`: a pause that is longer than any was set before the clock was.
DUE = """
    status = 'queued' AND id <> ALL(CAST(:but_not AS text[]))
    AND (not_before IS NULL OR not_before < clock_timestamp()
        OR not_before > clock_timestamp() + interval '60 s')
"""
# A waiting job, as `request` reads it. peak: what jobs like one that shares a GPU took of its memory.
HEAD = """
    SELECT id, queue, project, coalesce(owner, '') AS owner, gpu_bytes,
        (SELECT peaks.bytes FROM peaks WHERE peaks.alike = jobs.alike) AS peak
    FROM jobs
"""
# The oldest job of each queue, project and user. If these were compared for equality alone, PostgreSQL might
# take another index than `jobs_turns`, and read all that wait for each user.
HEADS = f"""
    WITH RECURSIVE heads AS (
        SELECT first.* FROM unnest(CAST(:queues AS text[])) AS queues (name) CROSS JOIN LATERAL (
            {HEAD} WHERE queue = queues.name AND {DUE}
            ORDER BY project, coalesce(owner, ''), id LIMIT 1
        ) AS first
        UNION ALL
        SELECT following.* FROM heads CROSS JOIN LATERAL (
            {HEAD} WHERE queue = heads.queue
                AND (project, coalesce(owner, '')) > (heads.project, heads.owner) AND {DUE}
            ORDER BY project, coalesce(owner, ''), id LIMIT 1
        ) AS following
    )
"""  # noqa: S608 # A constant.
# With those for which others drain. A row without a queue is of an older version.
_NEXT = f"""
    {HEADS}
    SELECT * FROM heads
    UNION ALL
    {HEAD} WHERE id = :told AND queue IS NULL AND {DUE}
    UNION
    SELECT awaited.* FROM (
        SELECT yields_to FROM jobs WHERE yields_to IS NOT NULL ORDER BY yields_to LIMIT 1000
    ) AS drained CROSS JOIN LATERAL (
        {HEAD} WHERE id = drained.yields_to AND queue = ANY(CAST(:queues AS text[])) AND {DUE} LIMIT 1
    ) AS awaited
"""  # noqa: S608 # A constant.


def running_query(yields_to: str, *more: str) -> str:
    """The running attempts, as `started_of` reads them. more: further columns.

    Status by status, and in an order that only the index `jobs_by_status` has, so that PostgreSQL walks that
    one: a plan by statistics, which are old where jobs come quickly, reads all attempts, or all that wait.
    """
    columns = ", ".join([f"{yields_to} AS yields_to", *more])
    return f"""
        SELECT jobs.id, jobs.queue, jobs.project, coalesce(jobs.owner, '') AS owner, jobs.token,
            attempts.worker, attempts.gpu_part, {columns},
            CAST(extract(epoch FROM clock_timestamp() - attempts.started_at) AS float) AS age_s
        FROM unnest(CAST(:held AS text[])) AS held (status)
        CROSS JOIN LATERAL (
            SELECT * FROM jobs WHERE status BETWEEN held.status AND held.status ORDER BY status, id
        ) AS jobs
        CROSS JOIN LATERAL (
            SELECT * FROM attempts WHERE job_id = jobs.id AND number = jobs.num_attempts LIMIT 1
        ) AS attempts
    """  # noqa: S608 # Constants.


_RUNNING = running_query(f"""(
    SELECT id FROM jobs AS waiting WHERE id = jobs.yields_to AND status = 'queued' AND coalesce(
        room_asked_at > clock_timestamp() - interval '{DRAINED_WITHIN_S} s', true
    )
)""")  # noqa: S608 # A constant.
# The oldest; what is beyond has no forecast.
_WAITING = f"{HEAD} WHERE status = 'queued' ORDER BY id LIMIT 20000"


def facts_query(**parts: str) -> TextClause:
    """All that a choice needs by one statement: a round trip for each part would take most of its time.

    parts: `waiting`, and perhaps `started`, as `facts_of` reads them. `moment` is the database's time.
    """
    parts = {**parts, "shares": SHARES, "quotas": "SELECT * FROM quotas"}
    columns = (
        f"(SELECT coalesce(json_agg(part), '[]') FROM ({query}) AS part) AS {name}"  # noqa: S608 # Constants.
        for name, query in parts.items()
    )
    return text(f"SELECT clock_timestamp() AS moment, {', '.join(columns)}")


_FACTS_OF_CLAIM = DriverStatement(facts_query(waiting=_NEXT, started=_RUNNING), _PLAN)
_NEXT_HEADS = DriverStatement(text(_NEXT), _PLAN)
_FACTS_OF_ALL = facts_query(waiting=_WAITING, started=_RUNNING)
# After so many jobs of one queue and user that it cannot run, a worker looks at those of others.
_MOST_UNFIT_OF_ONE = 10
# After so many of all users, one job of each is enough: other claims wait meanwhile.
_MOST_UNFIT = 100
# A queue, as its kind and rank, and whose jobs.
_Group = tuple[str, int, Who]


class TurnQueries(Session):
    """The part of a JobStore that says which job is next."""

    def take_turn(  # noqa: PLR0913 # Who, where, and what it is told.
        self,
        queues: Sequence[str],
        worker: str,
        *,
        lease: timedelta,
        secret: str,
        details: Mapping[str, Any] | None = None,
        fits: Callable[[Job], bool] = lambda job: True,
        told: str = "",
        offer: Offer | None = None,
    ) -> Job | None:
        asked = {"queues": list(queues), "but_not": [], "told": told, "held": list(HELD)}

        def take(connection: Connection, found: Values) -> Job | None:
            for row in found["started"]:
                if row["token"].endswith(f"-{secret}"):  # The answer to an earlier call was lost.
                    job = readable(find_job(connection, row["id"]))
                    if job.token == row["token"]:  # It was not taken back meanwhile.
                        return job
            claim_now = partial(claim, now=found["moment"])
            return _take(connection, asked, facts_of(found), find, claim_now, offer)

        def find(connection: Connection, job_id: str) -> Job | None:
            job = find_job(connection, job_id)
            return job if isinstance(job, Job) and fits(job) else None

        def claim(connection: Connection, job: Job, request: Request, now: datetime) -> Job:
            gpus, part = ("", None) if offer is None else offer.given_to(request)
            given = {GIVEN: gpus} if gpus else {}
            claimed = job.claimed(worker, now, secret, {**(details or {}), **given}, part)
            claim_job(connection, claimed, lease)
            return claimed

        with self._statements() as connection:
            (found,) = _FACTS_OF_CLAIM.rows(connection, asked)
            if all(quota["running"] is None for quota in found["quotas"]):
                return take(connection, found)
        with self._transaction() as connection:
            connection.execute(_ALONE)
            (found,) = _FACTS_OF_CLAIM.rows(connection, asked)
            return take(connection, found)

    def turn_facts(self) -> TurnFacts:
        with self._statements() as connection:
            return facts_of(columns(connection.execute(_FACTS_OF_ALL, {"held": list(HELD)}).one()))


def _take(  # What is known, and how a job is reached.
    connection: Connection,
    asked: Mapping[str, Any],
    facts: TurnFacts,
    find: Callable[[Connection, str], Job | None],
    claim: Callable[[Connection, Job, Request], Job],
    offer: Offer | None,
) -> Job | None:
    """The first job in turn that can be claimed. Raises NothingFits.

    asked: what the facts are of. find: returns None for a job that is for another worker. claim: takes the
    job that asks for this.
    """
    device = "gpu" if any(kind_of_queue(queue).accelerator == "gpu" for queue in asked["queues"]) else "cpu"
    standings, _ = standings_on(device, facts.shares, facts.started, facts.quotas)

    passed, unfit, heads = list[str](), Counter[_Group](), facts.waiting
    while True:
        first, kept = _first(heads, facts, standings, offer)
        if first is None:
            return None
        # These errors are ours: no statement has failed, and a transaction would go on.
        try:
            if (job := find(connection, first.id)) is not None:
                if kept is not None:
                    raise kept
                return claim(connection, job, first)
            unfit[_group(first)] += 1
        except (IllegalTransition, JobNotFound):  # It was cancelled, claimed or deleted meanwhile.
            pass
        except StaleJob:  # Another claim is about to have it, as a rule.
            standings.start(first)
        passed.append(first.id)
        most = _MOST_UNFIT_OF_ONE if unfit.total() < _MOST_UNFIT else 1
        if unfit[_group(first)] < most:
            heads = _heads(connection, {**asked, "but_not": passed})
        heads = [head for head in heads if unfit[_group(head)] < most]


def _first(
    heads: Sequence[Request], facts: TurnFacts, standings: Standings, offer: Offer | None
) -> tuple[Request | None, NothingFits | None]:
    """The one whose turn it is, and why it may not have what is offered."""
    if offer is None:
        return next(in_order(heads, standings), None), None
    try:
        return choose_for(offer, heads, facts), None
    except NothingFits as kept:
        return kept.request, kept


def _heads(connection: Connection, asked: Mapping[str, Any]) -> Sequence[Request]:
    return [request(row) for row in _NEXT_HEADS.rows(connection, asked)]


def _group(waiting: Request) -> _Group:
    return waiting.kind, waiting.rank, waiting.who


def facts_of(found: Mapping[str, Any], started: Sequence[Started] | None = None) -> TurnFacts:
    """started: those that were read before; otherwise they are among what was found."""
    return TurnFacts(
        waiting=[request(row) for row in found["waiting"]],
        started=[started_of(row) for row in found["started"]] if started is None else started,
        shares=[
            Share(row["device"], (row["project"], row["owner"]), row["amount"], row["usual_s"])
            for row in found["shares"]
        ],
        quotas=quotas_of(found["quotas"]),
    )


def request(row: Mapping[str, Any]) -> Request:
    """The request of a waiting job. A row without a queue is of an older version, and no urgent one."""
    queue = row["queue"]
    kind, name = kind_of_queue(queue), (queue or "").rpartition("-")[0]
    memory = row["gpu_bytes"]
    if memory is None and row["peak"] is not None:
        memory = share_for(row["peak"])
    gpus = max(1, kind.gpus) * kind.hosts
    who = (row["project"], row["owner"])
    return Request(row["id"], rank_of_queue(queue), who, gpus, kind=name, memory=memory)


@cache
def rank_of_queue(queue: str | None) -> int:
    """0 for the highest priority; the lowest for a row without a queue."""
    priority = (queue or "").rpartition("-")[2]
    return PRIORITIES.index(priority) if priority in PRIORITIES else len(PRIORITIES)


def started_of(row: Mapping[str, Any]) -> Started:
    kind = kind_of_queue(row["queue"])
    device = "gpu" if ":gpu" in row["worker"] else "cpu"  # As a worker names itself.
    gpus = max(1, kind.gpus) * kind.hosts
    who, rank = (row["project"], row["owner"]), rank_of_queue(row["queue"])
    yields_to = row["yields_to"] or ""
    return Started(
        row["id"],
        who,
        device,
        gpus,
        row["age_s"],
        row["worker"],
        rank,
        yields_to=yields_to,
        part=row["gpu_part"],
    )
