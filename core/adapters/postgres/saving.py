"""The next version of a job, written with all that it brings with it if the stored one is the one before.

That is one statement, since round trips took most of a claim's time. The rows of other tables come as JSON:
the statement is the same however many they are, and PostgreSQL keeps it prepared.
"""

from collections.abc import Sequence
from datetime import timedelta
from functools import cache
from typing import Any, NoReturn

from pydantic_core import to_json
from sqlalchemy import (
    JSON,
    Boolean,
    ColumnElement,
    Connection,
    Integer,
    Table,
    Text,
    and_,
    bindparam,
    case,
    cast,
    column,
    delete,
    exists,
    func,
    or_,
    select,
    true,
    update,
)
from sqlalchemy.dialects.postgresql import INTERVAL, insert

from core.adapters.postgres import leases, news, rows, usage
from core.adapters.postgres.engine import DriverStatement
from core.adapters.postgres.tables import NOW, artifacts, attempts, dispatches, entries, jobs, shares
from core.adapters.postgres.tables import news as messages
from core.adapters.postgres.tables import usage as ledger
from core.errors import JobNotFound, StaleJob
from core.jobs.job import Job
from core.jobs.news import news_of
from core.jobs.status import JobStatus
from core.jobs.store import Entry, note_entry, status_entry

# Rows of one call, which has two seconds: an import of 5,000 files was refused as an outage.
_AT_ONCE = 500
# A parameter that has a column's name would be its new value.
_ID = bindparam("saved", type_=Text)


# ---- The statement. ---------------------------------------------------------------------------------------


def _save(*conditions: ColumnElement[bool], is_claim: bool = False) -> DriverStatement:
    """A lease and a drain belong to the present attempt; a change of hands ends those of the one before.

    is_claim: it ends no attempt, and lets no job wait. Nor does it wait for the disk: if PostgreSQL is
    killed before the next write, it is as if nobody had claimed the job, and the lease that it gave is lost.
    """
    changed = {name: bindparam(f"new_{name}", type_=jobs.c[name].type) for name in rows.CHANGING}
    lease, num_told = bindparam("lease", type_=INTERVAL), bindparam("num_told", type_=Integer)
    kept = case(
        (changed["token"] == "", None),
        (lease.is_not(None), NOW + lease),
        (jobs.c.token == changed["token"], jobs.c.lease_until),
    )
    drains = case((jobs.c.token == changed["token"], jobs.c.yields_to))
    more = {"lease_until": kept, "yields_to": drains, "num_events": jobs.c.num_events + num_told}
    # A claim that is lost with the server has made a version of which its writer still knows: whoever comes
    # then makes another one of the same number.
    last_token, num_before = bindparam("last_token", type_=Text), bindparam("num_before", type_=Integer)
    is_open = and_(jobs.c.token == "", jobs.c.num_attempts >= num_before)
    is_the_one_before = and_(
        jobs.c.version == bindparam("version_before", type_=Integer),
        or_(jobs.c.token == last_token, is_open),
    )
    saved = (
        update(jobs)
        .where(jobs.c.id == _ID, is_the_one_before, *conditions)
        .values({**changed, **more})
        .returning(jobs.c.id, (jobs.c.num_events - num_told).label("last_before"))
        .cte("saved")
    )
    number = saved.c.last_before + _given(entries).c.number
    taken = delete(dispatches).where(
        dispatches.c.task == "attempt",
        dispatches.c.subject == _ID,
        bindparam("is_taken", type_=Boolean),
        exists(select(saved.c.id)),
    )
    tried = _insertion(attempts, saved)
    again = {one.name: tried.excluded[one.name] for one in attempts.c if not one.primary_key}
    parts = [
        tried.on_conflict_do_update(index_elements=["job_id", "number"], set_=again),
        _insertion(entries, saved, number=number, stored_at=NOW),
        taken,
        _insertion(messages, saved, created_at=NOW),
    ]
    answer = select(saved.c.id)
    if is_claim:
        answer = select(saved.c.id, func.set_config("synchronous_commit", "off", True))
    else:
        parts += [
            _insertion(dispatches, saved, created_at=NOW).on_conflict_do_nothing(),
            usage.added_to_ledger(_insertion(ledger, saved)),
            usage.added_to_shares(_insertion(shares, saved, at=NOW)),
        ]
    return DriverStatement(answer.add_cte(*(part.cte(f"part_{place}") for place, part in enumerate(parts))))


def _insertion(table: Table, saved: Any, **computed: Any) -> Any:
    """The given rows of a table, with some columns computed; none if the job is not saved."""
    given = _given(table)
    values = {**{one.name: given.c[one.name] for one in table.c}, **computed}
    wanted = select(*values.values()).select_from(saved.join(given, true()))
    return insert(table).from_select([*values], wanted)


@cache
def _given(table: Table) -> Any:
    """The rows in the table's parameter, as `_json` makes it."""
    name = f"given_{table.name}"
    given = func.json_to_recordset(cast(bindparam(name, type_=Text), JSON))
    columns = given.table_valued(*(column(one.name, one.type) for one in table.c))
    return columns.render_derived(name, with_types=True)


SAVE = _save()
# As if it were stale where somebody is about to change it; not where somebody refers to it, as by a new file.
_CLAIM = _save(
    jobs.c.id
    == select(jobs.c.id)
    .where(jobs.c.id == _ID)
    .with_for_update(skip_locked=True, key_share=True)
    .scalar_subquery(),
    is_claim=True,
)
TAKE_BACK = _save(leases.is_over())
_BEFORE = DriverStatement(
    select(
        jobs.c.version, jobs.c.status, exists().where(artifacts.c.job_id == _ID).label("has_artifacts")
    ).where(jobs.c.id == _ID)
)


# ---- Its uses. --------------------------------------------------------------------------------------------


def save_job(
    connection: Connection,
    job: Job,
    statement: DriverStatement = SAVE,
    *,
    lease: timedelta | None = None,
    note: str | None = None,
) -> None:
    """Write the job, its attempts and artifacts, its events, and the dispatch of a change of status.

    statement: `SAVE`, or with a further condition. Raises StaleJob, JobNotFound.
    """
    found = _BEFORE.rows(connection, {"saved": job.id})
    if not found:
        raise JobNotFound(job.id[:64])
    if found[0]["version"] != job.version - 1:
        raise StaleJob(job.id)
    if not statement.rows(connection, _values(job, rows.status(found[0]["status"]), lease, note)):
        refuse(connection, job.id)
    if job.artifacts or found[0]["has_artifacts"]:
        write_artifacts(connection, job)


def claim_job(connection: Connection, claimed: Job, lease: timedelta) -> None:
    """Write a new attempt, in one statement. Raises StaleJob, also for a job that is gone."""
    if not _CLAIM.rows(connection, _values(claimed, JobStatus.QUEUED, lease)):
        raise StaleJob(claimed.id)


def _values(job: Job, before: JobStatus, lease: timedelta | None, note: str | None = None) -> rows.Values:
    """The parameters of a statement. before: the status of the version before this one."""
    told = [] if before == job.status else [status_entry(job)]
    told += [] if note is None else [note_entry(note)]
    used, charged = usage.of_change(job, before)
    is_claim = before == JobStatus.QUEUED and job.status == JobStatus.STARTING
    return {
        **{f"new_{name}": value for name, value in rows.job_values(job).items()},
        "saved": job.id,
        "version_before": job.version - 1,
        "last_token": job.attempts[-1].token if job.attempts else "",
        "num_before": len(job.attempts) - is_claim,
        "lease": None if lease is None else rows.interval(lease),
        "num_told": len(told),
        "is_taken": job.status != JobStatus.QUEUED,
        # A step changes the last attempt, or the one before it.
        **_json(attempts, [rows.attempt_values(job.id, attempt) for attempt in job.attempts[-2:]]),
        **_json(entries, [_told_values(job.id, place, entry) for place, entry in enumerate(told, 1)]),
        **_json(dispatches, _waits(job)),
        **_json(ledger, used),
        **_json(shares, charged),
        **_json(messages, news.values_of(news_of(job, before))),
    }


def _json(table: Table, values: Sequence[rows.Values]) -> rows.Values:
    return {f"given_{table.name}": to_json(values).decode()}


def _told_values(job_id: str, place: int, entry: Entry) -> rows.Values:
    data = to_json(entry.data, inf_nan_mode="null").decode()
    own = {"kind": entry.kind, "time": entry.time, "data": data}
    return {"job_id": job_id, "channel": "events", "number": place, **own}


def _waits(job: Job) -> Sequence[rows.Values]:
    """Its dispatch, if it waits for a worker."""
    is_queued = job.status == JobStatus.QUEUED
    return [{"task": "attempt", "subject": job.id, "attempt": job.next_attempt}] if is_queued else []


def write_artifacts(connection: Connection, job: Job) -> None:
    """Bring the job's files in the record to those of this version."""
    stored = connection.execute(
        select(artifacts.c.name, artifacts.c.position, artifacts.c.key).where(artifacts.c.job_id == job.id)
    ).all()
    have = {row.name: row for row in stored}
    if gone := have.keys() - {artifact.name for artifact in job.artifacts}:
        connection.execute(delete(artifacts).where(artifacts.c.job_id == job.id, artifacts.c.name.in_(gone)))
    top = max((row.position for row in stored), default=0)
    new = list[rows.Values]()
    for artifact in job.artifacts:
        known = have.get(artifact.name)
        if known is None:
            top += 1
        if known is None or known.key != artifact.key:
            new.append(rows.artifact_values(job.id, top if known is None else known.position, artifact))
    if new:
        statement = insert(artifacts)
        changes = {name: statement.excluded[name] for name in new[0] if name not in ("job_id", "name")}
        write = statement.on_conflict_do_update(index_elements=["job_id", "name"], set_=changes)
        for at in range(0, len(new), _AT_ONCE):
            connection.execute(write, new[at : at + _AT_ONCE])


def refuse(connection: Connection, job_id: str) -> NoReturn:
    """Raises JobNotFound, or StaleJob for a job that is there."""
    if connection.execute(select(jobs.c.id).where(jobs.c.id == job_id)).first() is None:
        raise JobNotFound(job_id[:64])
    raise StaleJob(job_id)
