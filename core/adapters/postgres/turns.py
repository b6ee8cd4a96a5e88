"""Whose turn it is, decided where a job is claimed: in one transaction, which no other claim runs beside.

`core.jobs.turns` decides. It is told of the oldest waiting job of each queue and user, which an index has, so
that a claim takes as long among ten thousand jobs as among ten.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Connection, Row, select, text
from sqlalchemy.dialects.postgresql import insert

from core.accounts.store import Actor
from core.adapters.postgres.accounts import note_audit
from core.adapters.postgres.engine import Session
from core.adapters.postgres.jobs import save_job
from core.adapters.postgres.rows import HELD, find_job, readable
from core.adapters.postgres.tables import quotas as quotas_table
from core.adapters.postgres.usage import SHARES
from core.errors import IllegalTransition, JobNotFound, StaleJob
from core.jobs.job import Job
from core.jobs.pools import GIVEN, Offer, choose_for
from core.jobs.queue import PRIORITIES
from core.jobs.slots import kind_of_queue
from core.jobs.turns import Quota, Quotas, Request, Share, Started, TurnFacts, Who, in_order, standings_on

# An arbitrary number of ours: two claims wait for each other. Without sorting, PostgreSQL walks the index
# `jobs_turns` also where it has no statistics yet.
_BEGIN = text("SELECT pg_advisory_xact_lock(7310582061), set_config('enable_sort', 'off', true)")
# As `leases._is_due`: a pause that is longer than any was set before the clock was.
_DUE = """
    status = 'queued' AND id <> ALL(CAST(:but_not AS text[]))
    AND (not_before IS NULL OR not_before < clock_timestamp()
        OR not_before > clock_timestamp() + interval '60 s')
"""
_HEAD = "SELECT id, queue, project, coalesce(owner, '') AS owner FROM jobs"
# The oldest job of each queue, project and user. A row without a queue is of an older version.
_HEADS = text(f"""
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
""")  # noqa: S608 # A constant.
_RUNNING = text("""
    SELECT jobs.id, jobs.queue, jobs.project, coalesce(jobs.owner, '') AS owner, jobs.token, attempts.worker,
        CAST(extract(epoch FROM clock_timestamp() - attempts.started_at) AS float) AS age_s
    FROM jobs JOIN attempts ON attempts.job_id = jobs.id AND attempts.number = jobs.num_attempts
    WHERE jobs.status = ANY(CAST(:held AS text[]))
""")
# The oldest; what is beyond has no forecast.
_WAITING = text("""
    SELECT id, queue, project, coalesce(owner, '') FROM jobs WHERE status = 'queued' ORDER BY id LIMIT 20000
""")
# After so many jobs of one queue and user that it cannot run, a worker looks at those of others.
_MOST_UNFIT_OF_ONE = 10
# After so many of all users, one job of each is enough: other claims wait meanwhile.
_MOST_UNFIT = 100
# A queue, as its kind and rank, and whose jobs.
_Group = tuple[str, int, Who]


class TurnQueries(Session):
    """The part of a JobStore that says which job is next, and what users and projects may have."""

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
        with self._transaction() as connection:
            connection.execute(_BEGIN)
            running = connection.execute(_RUNNING, {"held": list(HELD)}).all()
            started = [_started(row) for row in running]
            device = "gpu" if any(kind_of_queue(queue).accelerator == "gpu" for queue in queues) else "cpu"
            if mine := [row.id for row in running if row.token.endswith(f"-{secret}")]:
                return readable(find_job(connection, mine[0]))  # The answer to an earlier call was lost.
            shares, quotas = _shares(connection), _quotas(connection)
            standings, _ = standings_on(device, shares, started, quotas)

            def next_of(heads: Sequence[Request]) -> Request | None:
                if offer is None:
                    return next(in_order(heads, standings), None)
                return choose_for(offer, heads, TurnFacts(heads, started, shares, quotas))

            unfit, unfit_of = list[str](), Counter[_Group]()
            heads = _heads(connection, queues, unfit, told)
            while (first := next_of(heads)) is not None:
                # Without the lock on rows, somebody may cancel or delete the job meanwhile, or claim it by
                # `save`. These errors are ours: no statement has failed, and the transaction goes on.
                with suppress(IllegalTransition, StaleJob, JobNotFound):
                    job = find_job(connection, first.id)
                    if isinstance(job, Job) and fits(job):
                        given = {} if offer is None else {GIVEN: offer.device(first.gpus)}
                        claimed = job.claimed(worker, now, secret, {**(details or {}), **given})
                        save_job(connection, claimed, lease=lease)
                        return claimed
                unfit.append(first.id)
                unfit_of[_group(first)] += 1
                most = _MOST_UNFIT_OF_ONE if len(unfit) < _MOST_UNFIT else 1
                if unfit_of[_group(first)] < most:
                    heads = _heads(connection, queues, unfit, told)
                heads = [head for head in heads if unfit_of[_group(head)] < most]
        return None

    def turn_facts(self) -> TurnFacts:
        with self._statements() as connection:
            return TurnFacts(
                waiting=[request(*row) for row in connection.execute(_WAITING)],
                started=[_started(row) for row in connection.execute(_RUNNING, {"held": list(HELD)})],
                shares=_shares(connection),
                quotas=_quotas(connection),
            )

    def quotas(self) -> Quotas:
        with self._statements() as connection:
            return _quotas(connection)

    def set_quota(self, kind: str, name: str, quota: Quota, actor: Actor) -> None:
        values = asdict(quota)
        write = insert(quotas_table).values(kind=kind, name=name, **values)
        with self._transaction() as connection:
            connection.execute(write.on_conflict_do_update(index_elements=["kind", "name"], set_=values))
            note_audit(connection, actor, "quota.set", f"{kind} {name}", **values)


def _heads(connection: Connection, queues: Sequence[str], but_not: Sequence[str], told: str) -> list[Request]:
    values = {"queues": list(queues), "but_not": list(but_not), "told": told}
    return [request(row.id, row.queue, row.project, row.owner) for row in connection.execute(_HEADS, values)]


def _group(waiting: Request) -> _Group:
    return waiting.kind, waiting.rank, waiting.who


def request(job_id: str, queue: str | None, project: str, owner: str) -> Request:
    """The request of a waiting job. A row without a queue is of an older version, and no urgent one."""
    kind = kind_of_queue(queue)
    name = (queue or "").rpartition("-")[0]
    return Request(job_id, rank_of_queue(queue), (project, owner), max(1, kind.gpus) * kind.hosts, kind=name)


def rank_of_queue(queue: str | None) -> int:
    """0 for the highest priority; the lowest for a row without a queue."""
    priority = (queue or "").rpartition("-")[2]
    return PRIORITIES.index(priority) if priority in PRIORITIES else len(PRIORITIES)


def _shares(connection: Connection) -> list[Share]:
    return [
        Share(row.device, (row.project, row.owner), row.amount, row.usual_s)
        for row in connection.execute(SHARES)
    ]


def _started(row: Row[Any]) -> Started:
    kind = kind_of_queue(row.queue)
    device = "gpu" if ":gpu" in row.worker else "cpu"  # As a worker names itself.
    gpus = max(1, kind.gpus) * kind.hosts
    return Started(
        row.id, (row.project, row.owner), device, gpus, row.age_s, row.worker, rank_of_queue(row.queue)
    )


def _quotas(connection: Connection) -> Quotas:
    found = connection.execute(select(quotas_table)).all()
    return Quotas(
        {
            (row.kind, row.name): Quota(row.weight, row.running, row.queued, row.gpu_hours, row.bytes)
            for row in found
        }
    )
