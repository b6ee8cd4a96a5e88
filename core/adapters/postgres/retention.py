"""What projects keep of their ended jobs, and the removal of the rest."""

import json
import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import structlog
from pydantic import TypeAdapter
from sqlalchemy import (
    Connection,
    Row,
    Text,
    TextClause,
    any_,
    bindparam,
    delete,
    func,
    literal,
    select,
    text,
    update,
)
from sqlalchemy.dialects.postgresql import ARRAY, insert

from core.accounts.store import Actor
from core.adapters.postgres import feeds
from core.adapters.postgres.accounts import note_audit, require_project
from core.adapters.postgres.engine import Session
from core.adapters.postgres.jobs import borrowers_of, delete_job
from core.adapters.postgres.rows import IDS
from core.adapters.postgres.tables import (
    NOW,
    UNFINISHED,
    artifacts,
    jobs,
    retention,
    sweeps,
    trials,
)
from core.documents import read_leniently
from core.jobs.job import JOB_ID, Origin, Removed
from core.jobs.retention import (
    PIN,
    RULES,
    Choice,
    EndedJob,
    Need,
    Removal,
    RetainedFile,
    Retention,
    RetentionRules,
    Sums,
    said_of,
)
from core.jobs.status import JobStatus
from core.jobs.store import note_entry

log = structlog.get_logger()

_REMOVED = TypeAdapter(list[Removed])
_FINAL = tuple(status.value for status in JobStatus if status.is_final)
_ACTIVE_SWEEPS = select(sweeps.c.id, sweeps.c.spec).where(sweeps.c.status.in_(("running", "cancelling")))
_GOING_TRIALS = (
    select(trials.c.job_id, trials.c.sweep_id)
    .join(sweeps, sweeps.c.id == trials.c.sweep_id)
    .where(sweeps.c.status.in_(("running", "cancelling")), trials.c.job_id == any_(IDS))
)
_ENDED = (
    select(
        jobs.c.id,
        jobs.c.version,
        jobs.c.name,
        jobs.c.owner,
        jobs.c.status,
        func.coalesce(jobs.c.finished_at, jobs.c.created_at).label("ended_at"),
        jobs.c.imported_from,
        jobs.c.labels.has_key(PIN).label("is_pinned"),
    )
    .where(
        jobs.c.project == bindparam("project"),
        jobs.c.status.in_(_FINAL),
        jobs.c.id > bindparam("after"),
    )
    .order_by(jobs.c.id)
    .limit(bindparam("most"))
)
_ENDED_OF = _ENDED.where(jobs.c.id == any_(IDS))
# What a `Choice` is. By a lateral join each job is looked up by the index: `= ANY` read the whole table for
# each page. A row for each job takes half the time of a row for each file.
_CHOSEN = """
    SELECT wanted.id, found.* FROM unnest(CAST(:ids AS text[])) AS wanted (id), LATERAL (
        SELECT name, role, step, size, 1 AS number,
            dense_rank() OVER (PARTITION BY role ORDER BY coalesce(step, 0) DESC) AS place
        FROM artifacts WHERE job_id = wanted.id AND role = ANY (CAST(:roles AS text[]))
    ) AS found WHERE role <> 'checkpoint' OR place > :keep
"""
_WHOLE = """
    SELECT wanted.id, found.role AS name, found.role, NULL AS step, found.size, found.number
    FROM unnest(CAST(:ids AS text[])) AS wanted (id), LATERAL (
        SELECT role, sum(size) AS size, count(*) AS number
        FROM artifacts WHERE job_id = wanted.id GROUP BY role
        UNION ALL
        SELECT 'feed', sum(size), count(*) FROM chunks WHERE job_id = wanted.id HAVING count(*) > 0
    ) AS found
"""
_FILES, _SUMS = (
    {is_whole: text(wanted.format(chosen)) for is_whole, chosen in ((False, _CHOSEN), (True, _WHOLE))}
    for wanted in (
        """
        SELECT id, array_agg(name), array_agg(role), array_agg(step), array_agg(CAST(size AS bigint)),
            array_agg(number) FROM ({}) AS chosen GROUP BY id
        """,
        """
        SELECT id, role, CAST(sum(number) AS bigint) AS number, CAST(sum(size) AS bigint) AS size
        FROM ({}) AS chosen GROUP BY GROUPING SETS ((id), (role))
        """,
    )
)
_source = jobs.alias("source")
_NEEDS = (
    select(_source.c.id.label("source"), jobs.c.id, jobs.c.source_step, jobs.c.project)
    .join(_source, _source.c.id == jobs.c.source)
    .where(jobs.c.status.in_(UNFINISHED), _source.c.project == bindparam("project"))
    .order_by(jobs.c.id)
)


class RetentionQueries(Session):
    """A RetentionStore."""

    def retention(self, project: str) -> Retention | None:
        with self._statements() as connection:
            require_project(connection, project)
            row = connection.execute(select(retention).where(retention.c.project == project)).first()
        return None if row is None else _readable(row)

    def retentions(self) -> Sequence[Retention]:
        with self._statements() as connection:
            found = connection.execute(select(retention).order_by(retention.c.project)).all()
        return [readable for row in found if (readable := _readable(row)) is not None]

    def set_retention(self, project: str, rules: RetentionRules, actor: Actor) -> Retention:
        values = {"rules": rules.model_dump_json(), "set_at": NOW, "set_by": actor.user}
        write = insert(retention).values(project=project, **values)
        write = write.on_conflict_do_update(index_elements=["project"], set_=values)
        with self._transaction() as connection:
            require_project(connection, project)
            row = connection.execute(write.returning(*retention.c)).one()
            note_audit(connection, actor, "retention.set", f"project {project}", **rules.given())
        return _retention(row)

    def end_retention(self, project: str, actor: Actor) -> None:
        gone = delete(retention).where(retention.c.project == project).returning(retention.c.project)
        with self._transaction() as connection:
            require_project(connection, project)
            if connection.execute(gone).first() is not None:
                note_audit(connection, actor, "retention.ended", f"project {project}")

    def ended_jobs(
        self, project: str, *, ids: Collection[str] | None = None, after: str = "", limit: int = 1000
    ) -> Sequence[EndedJob]:
        page = {"project": project, "after": after, "most": limit}
        with self._statements() as connection:
            if ids is None:
                found = connection.execute(_ENDED, page).all()
            else:
                found = connection.execute(_ENDED_OF, {**page, "ids": [*ids]}).all()
            sweep_of = _sweeps_that_go_on(connection, [row.id for row in found])
        return [_ended(row, sweep_of.get(row.id)) for row in found]

    def files_of_ended(
        self, job_ids: Collection[str], choice: Choice
    ) -> Mapping[str, Sequence[RetainedFile]]:
        found = self._of_chosen(_FILES, job_ids, choice)
        return {job_id: [*map(RetainedFile, *facts)] for job_id, *facts in found}

    def sums_of_ended(self, job_ids: Collection[str], choice: Choice) -> Sums:
        found = self._of_chosen(_SUMS, job_ids, choice)
        by_job = {row.id: (row.number, row.size) for row in found if row.role is None}
        return Sums(by_job, {row.role: (row.number, row.size) for row in found if row.role is not None})

    def _of_chosen(
        self, wanted: Mapping[bool, TextClause], job_ids: Collection[str], choice: Choice
    ) -> Sequence[Row[Any]]:
        if not job_ids or not (choice.roles or choice.is_whole):
            return ()
        which = {} if choice.is_whole else {"roles": [*choice.roles], "keep": choice.keep}
        with self._statements() as connection:
            return connection.execute(wanted[choice.is_whole], {"ids": [*job_ids], **which}).all()

    def checkpoint_needs(self, project: str) -> Mapping[str, Sequence[Need]]:
        by_job = defaultdict[str, list[Need]](list)
        with self._statements() as connection:
            for row in connection.execute(_NEEDS, {"project": project}):
                by_job[row.source].append(Need(row.id, row.source_step, row.project))
        return by_job

    def remove_retained(self, removal: Removal, by: Retention) -> Sequence[str] | None:
        gone: Sequence[str] = ()
        job = removal.job
        in_force = select(retention.c.project).where(
            retention.c.project == by.project, retention.c.set_at == by.set_at
        )
        is_pinned = jobs.c.labels.has_key(PIN).label("is_pinned")
        held = select(jobs.c.version, jobs.c.removed, is_pinned).where(jobs.c.id == job.id).with_for_update()
        with self._transaction() as connection:
            # Whoever changes the rules waits for this, and then they remove nothing more.
            if connection.execute(in_force.with_for_update(read=True)).first() is None:
                return None
            # With `hold_source`: a job that needs a checkpoint comes before this, or finds it gone.
            row = connection.execute(held).first()
            if row is None or row.version != job.version or row.is_pinned:
                return None
            # With `add_sweep`, likewise.
            if _sweeps_that_go_on(connection, [job.id]):
                return None
            needs = connection.execute(borrowers_of(job.id)).all()
            if removal.is_whole:
                if needs:
                    return None
                delete_job(connection, job.id, job.version)
            else:
                steps = {need.source_step for need in needs}
                removal = removal.without(lambda file: file.role == "checkpoint" and file.step in steps)
                if not removal.files:
                    return None
                gone = _remove_files(connection, removal, by.rules, row.removed)
            note_audit(
                connection,
                Actor(),
                "retention.applied",
                f"project {by.project}",
                job=job.id,
                whole=removal.is_whole,
                rules={rule: getattr(by.rules, rule) for rule in removal.files},
                files=removal.num_files,
                bytes=removal.num_bytes,
            )
        return gone


def _remove_files(
    connection: Connection, removal: Removal, rules: RetentionRules, before: str | None
) -> Sequence[str]:
    """Take the files out of the record of a job, which is locked, and say so there; returns their keys."""
    job_id = removal.job.id
    names = [file.name for file in removal.all_files]
    its = (artifacts.c.job_id == job_id) & (artifacts.c.name == any_(literal(names, ARRAY(Text))))
    gone = connection.execute(delete(artifacts).where(its).returning(artifacts.c.key)).scalars().all()
    now = connection.execute(select(NOW)).scalar_one()
    told = _added(job_id, before, removal, now)
    left = select(func.coalesce(func.sum(artifacts.c.size), 0)).where(artifacts.c.job_id == job_id)
    changes = {"version": jobs.c.version + 1, "removed": told, "bytes": left.scalar_subquery()}
    connection.execute(update(jobs).where(jobs.c.id == job_id).values(changes))
    feeds.append(connection, job_id, "events", [note_entry(said_of(removal, rules))])
    return gone


def _added(job_id: str, before: str | None, removal: Removal, now: datetime) -> str:
    """What rules have removed of the job, with this removal; without what cannot be read."""
    try:
        known = {one.rule: one for one in _REMOVED.validate_json(before or "[]")}
    except ValueError as error:
        log.warning("removed_unreadable", job_id=job_id, problem=str(error))
        known = {}
    for rule, files in removal.files.items():
        had = known.get(rule, Removed(rule=rule, at=now, files=0, size=0))
        known[rule] = Removed(
            rule=rule,
            at=now,
            files=had.files + len(files),
            size=had.size + sum(file.size for file in files),
        )
    return json.dumps([one.model_dump(mode="json") for one in known.values()])


def _sweeps_that_go_on(connection: Connection, job_ids: Sequence[str]) -> dict[str, str]:
    """Of these jobs those that an active sweep has as a trial, or that its specification names."""
    trials_of = connection.execute(_GOING_TRIALS, {"ids": [*job_ids]}).all()
    found = {row.job_id: row.sweep_id for row in trials_of}
    wanted = set(job_ids)
    for sweep in connection.execute(_ACTIVE_SWEEPS):
        found |= dict.fromkeys(wanted.intersection(re.findall(JOB_ID, sweep.spec)), sweep.id)
    return found


# Days since then have not passed: no rule of days is due.
_NEVER = datetime.max.replace(tzinfo=UTC)


def _ended(row: Any, sweep: str | None) -> EndedJob:
    since = row.ended_at
    if row.imported_from is not None:
        try:
            since = max(since, Origin.model_validate_json(row.imported_from).imported_at)
        except (ValueError, TypeError) as error:  # A time without a zone is no ValueError.
            log.warning("origin_unreadable", job_id=row.id, problem=str(error))
            since = _NEVER
    return EndedJob(
        row.id,
        row.version,
        row.name,
        row.owner,
        JobStatus(row.status),
        since,
        is_pinned=row.is_pinned,
        sweep=sweep,
    )


def _readable(row: Row[Any]) -> Retention | None:
    """None where nobody can read the rules: the project keeps everything until it sets others."""
    try:
        return _retention(row)
    except ValueError as error:
        log.warning("retention_unreadable", project=row.project, problem=str(error))
        return None


def _retention(row: Row[Any]) -> Retention:
    return Retention(
        project=row.project,
        rules=read_leniently(row.rules, RULES),
        set_at=row.set_at,
        set_by=row.set_by,
    )
