"""Whose turn it is, decided where a job is claimed, in one transaction.

A claim passes a job by that another one is about to take, and counts it as started: claims do not wait for
each other. Where somebody has a quota of running jobs they do, so that it is exact.
`core.jobs.turns` decides. It is told of the oldest waiting job of each queue and user, which an index has, so
that a claim takes as long among ten thousand jobs as among ten.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, Row, TextClause, text

from core.adapters.postgres.engine import Session
from core.adapters.postgres.quotas import quotas_of
from core.adapters.postgres.rows import HELD, find_job, readable
from core.adapters.postgres.saving import SAVE_AT_ONCE, save_change
from core.adapters.postgres.usage import SHARES
from core.errors import IllegalTransition, JobNotFound, StaleJob
from core.jobs.job import Job
from core.jobs.pools import GIVEN, NothingFits, Offer, choose_for
from core.jobs.preemption import DRAINED_WITHIN_S
from core.jobs.queue import PRIORITIES
from core.jobs.slots import kind_of_queue
from core.jobs.turns import Request, Share, Started, TurnFacts, Who, in_order, standings_on

# Without sorting, PostgreSQL walks the index `jobs_turns` also where it has no statistics yet. Planning anew
# for each claim would take half of its time.
_PLAN = text("""
    SELECT set_config('enable_sort', 'off', true), set_config('plan_cache_mode', 'force_generic_plan', true)
""")
# An arbitrary number of ours: who comes second waits until the first one's transaction has ended.
_ALONE = text("SELECT pg_advisory_xact_lock(7310582061)")
# As `leases._is_due`: a pause that is longer than any was set before the clock was.
_DUE = """
    status = 'queued' AND id <> ALL(CAST(:but_not AS text[]))
    AND (not_before IS NULL OR not_before < clock_timestamp()
        OR not_before > clock_timestamp() + interval '60 s')
"""
_HEAD = "SELECT id, queue, project, coalesce(owner, '') AS owner FROM jobs"
# The oldest job of each queue, project and user, and those for which others drain. A row without a queue is
# of an older version.
_HEADS = f"""
    WITH RECURSIVE heads AS (
        SELECT first.* FROM unnest(CAST(:queues AS text[])) AS queues (name) CROSS JOIN LATERAL (
            {_HEAD} WHERE queue = queues.name AND {_DUE}
            ORDER BY project, coalesce(owner, ''), id LIMIT 1
        ) AS first
        UNION ALL
        SELECT following.* FROM heads CROSS JOIN LATERAL (
            {_HEAD} WHERE queue = heads.queue
                AND (project, coalesce(owner, '')) > (heads.project, heads.owner) AND {_DUE}
            ORDER BY project, coalesce(owner, ''), id LIMIT 1
        ) AS following
    )
    SELECT * FROM heads
    UNION ALL
    {_HEAD} WHERE id = :told AND queue IS NULL AND {_DUE}
    UNION
    SELECT awaited.* FROM (
        SELECT yields_to FROM jobs WHERE yields_to IS NOT NULL ORDER BY yields_to LIMIT 1000
    ) AS drained CROSS JOIN LATERAL (
        {_HEAD} WHERE id = drained.yields_to AND queue = ANY(CAST(:queues AS text[])) AND {_DUE} LIMIT 1
    ) AS awaited
"""  # noqa: S608 # A constant.


def running_query(yields_to: str, *more: str) -> str:
    """The running attempts, as `started_of` reads them. more: further columns."""
    columns = ", ".join([f"{yields_to} AS yields_to", *more])
    return f"""
        SELECT jobs.id, jobs.queue, jobs.project, coalesce(jobs.owner, '') AS owner, jobs.token,
            attempts.worker, {columns},
            CAST(extract(epoch FROM clock_timestamp() - attempts.started_at) AS float) AS age_s
        FROM jobs JOIN attempts ON attempts.job_id = jobs.id AND attempts.number = jobs.num_attempts
        WHERE jobs.status = ANY(CAST(:held AS text[]))
    """  # noqa: S608 # Constants.


_RUNNING = running_query(f"""(
    SELECT id FROM jobs AS waiting WHERE id = jobs.yields_to AND status = 'queued' AND coalesce(
        room_asked_at > clock_timestamp() - interval '{DRAINED_WITHIN_S} s', true
    )
)""")  # noqa: S608 # A constant.
# The oldest; what is beyond has no forecast.
_WAITING = """
    SELECT id, queue, project, coalesce(owner, '') AS owner FROM jobs WHERE status = 'queued'
    ORDER BY id LIMIT 20000
"""


def facts_query(waiting: str) -> TextClause:
    """All that a choice needs by one statement: a round trip for each part would take most of its time."""
    parts = {"waiting": waiting, "started": _RUNNING, "shares": SHARES, "quotas": "SELECT * FROM quotas"}
    columns = (
        f"(SELECT coalesce(json_agg(part), '[]') FROM ({query}) AS part) AS {name}"  # noqa: S608 # Constants.
        for name, query in parts.items()
    )
    return text(f"SELECT {', '.join(columns)}")


_FACTS_OF_CLAIM, _FACTS_OF_ALL, _NEXT_HEADS = facts_query(_HEADS), facts_query(_WAITING), text(_HEADS)
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
        now: datetime,
        lease: timedelta,
        secret: str,
        details: Mapping[str, Any] | None = None,
        fits: Callable[[Job], bool] = lambda job: True,
        told: str = "",
        offer: Offer | None = None,
    ) -> Job | None:
        def claim(connection: Connection, first: Request, kept: NothingFits | None) -> Job | None:
            job = find_job(connection, first.id)
            if not isinstance(job, Job) or not fits(job):
                return None
            if kept is not None:
                raise kept
            given = {} if offer is None else {GIVEN: offer.device(first.gpus)}
            claimed = job.claimed(worker, now, secret, {**(details or {}), **given})
            save_change(connection, claimed, job.status, SAVE_AT_ONCE, lease=lease)
            return claimed

        asked = {"queues": list(queues), "but_not": [], "told": told, "held": list(HELD)}
        with self._transaction() as connection:
            connection.execute(_PLAN)
            found = connection.execute(_FACTS_OF_CLAIM, asked).one()
            if mine := [row["id"] for row in found.started if row["token"].endswith(f"-{secret}")]:
                return readable(find_job(connection, mine[0]))  # The answer to an earlier call was lost.
            facts = facts_of(found)
            if any(quota.running is not None for quota in facts.quotas.by_party.values()):
                connection.execute(_ALONE)
                facts = facts_of(connection.execute(_FACTS_OF_CLAIM, asked).one())
            return _take(connection, asked, facts, claim, offer)

    def turn_facts(self) -> TurnFacts:
        with self._statements() as connection:
            return facts_of(connection.execute(_FACTS_OF_ALL, {"held": list(HELD)}).one())


def _take(
    connection: Connection,
    asked: Mapping[str, Any],
    facts: TurnFacts,
    claim: Callable[[Connection, Request, NothingFits | None], Job | None],
    offer: Offer | None,
) -> Job | None:
    """The first job in turn that can be claimed. Raises NothingFits.

    asked: what the facts are of. claim: returns None for a job that is for another worker; of another one, it
    raises what it is given.
    """
    device = "gpu" if any(kind_of_queue(queue).accelerator == "gpu" for queue in asked["queues"]) else "cpu"
    standings, _ = standings_on(device, facts.shares, facts.started, facts.quotas)

    def next_of(heads: Sequence[Request]) -> tuple[Request | None, NothingFits | None]:
        if offer is None:
            return next(in_order(heads, standings), None), None
        try:
            return choose_for(offer, heads, facts), None
        except NothingFits as kept:
            return kept.request, kept

    passed, unfit, heads = list[str](), Counter[_Group](), facts.waiting
    while True:
        first, kept = next_of(heads)
        if first is None:
            return None
        # These errors are ours: no statement has failed, and the transaction goes on.
        try:
            if (claimed := claim(connection, first, kept)) is not None:
                return claimed
            unfit[_group(first)] += 1
        except (IllegalTransition, JobNotFound):  # It was cancelled, claimed or deleted meanwhile.
            pass
        except StaleJob:  # Another claim is about to have it, as a rule.
            standings.start(first)
        passed.append(first.id)
        most = _MOST_UNFIT_OF_ONE if unfit.total() < _MOST_UNFIT else 1
        if unfit[_group(first)] < most:
            rows = connection.execute(_NEXT_HEADS, {**asked, "but_not": passed}).mappings()
            heads = [_request(row) for row in rows]
        heads = [head for head in heads if unfit[_group(head)] < most]


def _group(waiting: Request) -> _Group:
    return waiting.kind, waiting.rank, waiting.who


def facts_of(found: Row[Any]) -> TurnFacts:
    return TurnFacts(
        waiting=[_request(row) for row in found.waiting],
        started=[started_of(row) for row in found.started],
        shares=[
            Share(row["device"], (row["project"], row["owner"]), row["amount"], row["usual_s"])
            for row in found.shares
        ],
        quotas=quotas_of(found.quotas),
    )


def _request(row: Any) -> Request:
    return request(row["id"], row["queue"], row["project"], row["owner"])


def request(job_id: str, queue: str | None, project: str, owner: str) -> Request:
    """The request of a waiting job. A row without a queue is of an older version, and no urgent one."""
    kind = kind_of_queue(queue)
    name = (queue or "").rpartition("-")[0]
    return Request(job_id, rank_of_queue(queue), (project, owner), max(1, kind.gpus) * kind.hosts, kind=name)


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
    return Started(row["id"], who, device, gpus, row["age_s"], row["worker"], rank, yields_to=yields_to)
