"""Running jobs that are told to make room for waiting ones; `core.jobs.preemption` decides.

What is decided is written into the row of the job that makes room: its attempt hears of it at the next
heartbeat, and by the end of the attempt it is forgotten.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import structlog
from sqlalchemy import Connection, Row, text

from core.adapters.postgres import workers
from core.adapters.postgres.engine import Session
from core.adapters.postgres.leases import in_words
from core.adapters.postgres.rows import HELD, columns, find_job
from core.adapters.postgres.turns import (
    DUE,
    HEAD,
    HEADS,
    facts_of,
    facts_query,
    rank_of_queue,
    running_query,
    started_of,
)
from core.errors import JobNotFound
from core.jobs.job import Job
from core.jobs.pools import pool_of
from core.jobs.preemption import (
    ASKED_AGAIN_S,
    DRAINED_WITHIN_S,
    Holders,
    making_room,
    may_be_asked,
)
from core.jobs.queue import PRIORITIES
from core.jobs.turns import Request
from core.jobs.workers import WorkerInfo, able_to_run

log = structlog.get_logger()

# An arbitrary number of ours: one reconciler decides at a time. The rest as for a claim.
_BEGIN = text("SELECT pg_try_advisory_xact_lock(7310582062), set_config('enable_sort', 'off', true)")
_RUNNING = text(running_query("jobs.yields_to", "jobs.kind", "jobs.status", "jobs.preemptible"))
# The oldest twenty of each queue, project and user.
_OLDEST = f"""
    {HEADS}
    SELECT oldest.* FROM heads CROSS JOIN LATERAL (
        {HEAD} WHERE queue = heads.queue AND {DUE}
            AND (project, coalesce(owner, ''), id) >= (heads.project, heads.owner, heads.id)
        ORDER BY project, coalesce(owner, ''), id LIMIT 20
    ) AS oldest
    WHERE (oldest.project, oldest.owner) = (heads.project, heads.owner)
"""  # noqa: S608 # A constant.
_FACTS = facts_query(waiting=_OLDEST)
_ASKED = text("""
    SELECT id, CAST(extract(epoch FROM clock_timestamp() - room_asked_at) AS float) AS age_s
    FROM jobs WHERE id = ANY(CAST(:waiting AS text[])) AND room_asked_at IS NOT NULL
""")
# Nobody makes room for a job that waits no more; nor does an attempt that has ended meanwhile, or is being
# cancelled.
_ASK = text("UPDATE jobs SET room_asked_at = clock_timestamp() WHERE id = :waiting AND status = 'queued'")
_TELL = text("""
    UPDATE jobs SET yields_to = :waiting
    WHERE id = :id AND token = :token AND status IN ('starting', 'running') AND yields_to IS NULL
""")
_ROOMS = text("""
    SELECT jobs.id, jobs.yields_to, jobs.project = waiting.project AS is_of_its_project
    FROM jobs JOIN jobs AS waiting ON waiting.id = jobs.yields_to
    WHERE jobs.yields_to IS NOT NULL AND jobs.status = ANY(CAST(:held AS text[])) ORDER BY jobs.id
""")


class PreemptionQueries(Session):
    """The part of a JobStore that makes room for waiting jobs."""

    def make_room(self) -> Mapping[str, Sequence[str]]:
        with self._transaction() as connection:
            if not connection.execute(_BEGIN).scalar():
                return {}
            running = connection.execute(_RUNNING, {"held": list(HELD)}).all()
            started = [
                replace(started_of(columns(row)), is_preemptible=bool(row.preemptible)) for row in running
            ]
            movable = {row.id for row in running if _is_movable(row)}
            ranks = [rank for rank in range(len(PRIORITIES)) if may_be_asked(started, movable, rank)]
            if not ranks:
                return {}
            present = workers.present(connection)
            served = {queue for worker in present for queue in worker.queues}
            queues = [queue for queue in served if rank_of_queue(queue) in ranks]
            asked = {"queues": queues, "but_not": list[str]()}
            facts = facts_of(columns(connection.execute(_FACTS, asked).one()), started)
            if not facts.waiting:
                return {}
            drains = {row.id: row.yields_to for row in running if row.yields_to is not None}
            waiting = [*(request.id for request in facts.waiting), *drains.values()]
            asked_s = {row.id: row.age_s for row in connection.execute(_ASKED, {"waiting": waiting})}
            drains = {
                job: waits for job, waits in drains.items() if asked_s.get(waits, 0.0) < DRAINED_WITHIN_S
            }
            just_asked = {waits for waits, age_s in asked_s.items() if age_s < ASKED_AGAIN_S}
            holders = Holders(facts, movable, drains, just_asked)
            found = making_room(holders, present, partial(_able, connection, present))
            tokens = {row.id: row.token for row in running}
            return {
                waits: victims
                for waits, victims in found.items()
                if _tell(connection, waits, victims, tokens)
            }

    def rooms(self) -> Mapping[str, Sequence[str]]:
        found = defaultdict[str, list[str]](list)
        with self._statements() as connection:
            for row in connection.execute(_ROOMS, {"held": list(HELD)}):
                found[row.yields_to].append(in_words(row.id, row.is_of_its_project))
        return found


def _tell(connection: Connection, waits: str, victims: Sequence[str], tokens: Mapping[str, str]) -> bool:
    """Write down who makes room for the job; False if it waits no more."""
    if not connection.execute(_ASK, {"waiting": waits}).rowcount:
        return False
    for victim in victims:
        connection.execute(_TELL, {"waiting": waits, "id": victim, "token": tokens[victim]})
    return True


def _able(connection: Connection, present: Sequence[WorkerInfo], waits: Request) -> Collection[str]:
    """The names of the pools that could run the job."""
    try:
        job = find_job(connection, waits.id)
    except JobNotFound:
        return ()
    if not isinstance(job, Job):
        return ()
    try:
        return {pool_of(one) for one in able_to_run(job, present)}
    except Exception:  # Of another version, it may say anything; the chore has leases to watch.
        log.warning("job_gets_no_room", job_id=waits.id, exc_info=True)
        return ()


def _is_movable(row: Row[Any]) -> bool:
    return row.kind == "train" and row.status in ("starting", "running") and row.yields_to is None
