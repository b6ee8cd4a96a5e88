"""The records of sweeps and of their trials."""

import json
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

import structlog
from pydantic_core import from_json
from sqlalchemy import ColumnElement, Connection, Row, and_, delete, func, literal, select, update
from sqlalchemy.dialects.postgresql import aggregate_order_by, insert

from core.adapters.postgres import deletions, loading, pages, rows, submissions
from core.adapters.postgres.tables import NOW, jobs, sweeps, trials
from core.errors import IdempotencyKeyReused, JobNotFound, StaleSweep, SweepNotFound, TooManySweeps
from core.jobs.job import Job, UnreadableJob
from core.jobs.store import Idempotency
from core.sweeps.spec import SWEEP_SPEC
from core.sweeps.store import SweepMark
from core.sweeps.sweep import Sweep, SweepStatus, Trial

log = structlog.get_logger()

_FOUND = {"importance", "importance_note", "num_judged"}
_ACTIVE = ("running", "cancelling")


def add(
    connection: Connection, sweep: Sweep, idempotency: Idempotency | None, most_active: int | None = None
) -> Sweep:
    """Add the sweep; or return the one that has the key. Raises IdempotencyKeyReused, TooManySweeps."""
    has_room = most_active is None or num_active(connection) < most_active
    values = {**_values(sweep), "id": sweep.id, "created_at": sweep.created_at}
    if idempotency is None:
        _check_room(most_active, has_room=has_room)
        connection.execute(insert(sweeps).values(values))
        return sweep
    key_hash = submissions.hashed(idempotency.key)
    is_forgotten = sweeps.c.created_at <= NOW - submissions.REMEMBERED
    connection.execute(
        update(sweeps)
        .where(sweeps.c.key_hash == key_hash, is_forgotten)
        .values(key_hash=None, fingerprint=None)
    )
    values |= {"key_hash": key_hash, "fingerprint": idempotency.fingerprint}
    new = insert(sweeps).values(values).on_conflict_do_nothing(index_elements=["key_hash"])
    if connection.execute(new.returning(sweeps.c.id)).first() is not None:
        _check_room(most_active, has_room=has_room)  # What was inserted is rolled back.
        return sweep
    row = connection.execute(select(sweeps).where(sweeps.c.key_hash == key_hash)).first()
    if row is None:  # It was deleted between the two statements.
        return add(connection, sweep, idempotency, most_active)
    if row.fingerprint != idempotency.fingerprint:
        raise IdempotencyKeyReused(idempotency.key)
    return _sweep(row)


def _check_room(most_active: int | None, *, has_room: bool) -> None:
    if most_active is not None and not has_room:
        raise TooManySweeps(most_active)


def get(connection: Connection, sweep_id: str) -> Sweep:
    row = connection.execute(select(sweeps).where(sweeps.c.id == sweep_id)).first()
    if row is None:
        raise SweepNotFound(sweep_id[:64])
    return _sweep(row)


def save(connection: Connection, sweep: Sweep) -> None:
    changed = connection.execute(
        update(sweeps)
        .where(sweeps.c.id == sweep.id, sweeps.c.version == sweep.version - 1)
        .values(_values(sweep))
        .returning(sweeps.c.id)
    )
    if changed.first() is None:
        _refuse(connection, sweep.id)


def remove(connection: Connection, sweep_id: str, version: int) -> None:
    found = delete(sweeps).where(sweeps.c.id == sweep_id, sweeps.c.version == version)
    if connection.execute(found.returning(sweeps.c.id)).first() is None:
        _refuse(connection, sweep_id)


def newest(
    connection: Connection, status: SweepStatus | None, before: str | None, limit: int
) -> tuple[list[Sweep], bool]:
    """Some sweeps, fewer where they and their trials are long (`pages`), and whether there are more."""
    wanted = select(sweeps).order_by(sweeps.c.id.desc()).limit(limit + 1)
    if status is not None:
        wanted = wanted.where(sweeps.c.status == status.value)
    if before is not None:
        wanted = wanted.where(sweeps.c.id < before)
    said = select(func.coalesce(func.sum(func.octet_length(trials.c.said)), 0)).where(
        trials.c.sweep_id == sweeps.c.id
    )
    size = func.octet_length(sweeps.c.spec) + said.scalar_subquery()
    found = connection.execute(pages.by_bytes(wanted, size, "id")).all()
    return [_sweep(row) for row in found[:limit]], pages.has_more(found, min(len(found), limit))


def num_active(connection: Connection) -> int:
    wanted = select(func.count()).select_from(sweeps).where(sweeps.c.status.in_(_ACTIVE))
    return connection.execute(wanted).scalar_one()


def active_marks(connection: Connection) -> Mapping[str, SweepMark]:
    """Oldest first. Of the trials only those are read that have not ended, by the index `trials_going`."""
    going = and_(trials.c.sweep_id == sweeps.c.id, trials.c.outcome.is_(None))
    of_trials = sweeps.outerjoin(trials, going).outerjoin(jobs, jobs.c.id == trials.c.job_id)
    wanted = (
        select(
            sweeps.c.id,
            sweeps.c.version,
            _digest(trials.c.number, jobs.c.id, jobs.c.version).label("going"),
            _digest(trials.c.number, jobs.c.num_events).label("events"),
        )
        .select_from(of_trials)
        .where(sweeps.c.status.in_(_ACTIVE))
        .group_by(sweeps.c.id)
        .order_by(sweeps.c.id)
    )
    return {row.id: SweepMark(row.version, row.going, row.events) for row in connection.execute(wanted)}


def _digest(*said: ColumnElement[Any]) -> ColumnElement[Any]:
    """A digest over all rows of a group; null for a group without trials."""
    row = func.concat_ws(" ", *said)
    return func.md5(func.string_agg(row, aggregate_order_by(literal(","), trials.c.number)))


def active(connection: Connection, among: Collection[str] | None) -> Sequence[Sweep]:
    """Oldest first. One that cannot be read is left out: a newer version may have written it."""
    found: list[Sweep] = []
    wanted = select(sweeps).where(sweeps.c.status.in_(_ACTIVE)).order_by(sweeps.c.id)
    if among is not None:
        wanted = wanted.where(sweeps.c.id.in_(among))
    for row in connection.execute(wanted):
        try:
            found.append(_sweep(row))
        except ValueError as error:
            log.warning("sweep_unreadable", sweep=row.id, problem=str(error))
    return found


def trials_of(connection: Connection, sweep_ids: Collection[str]) -> Mapping[str, Sequence[Trial]]:
    found: dict[str, list[Trial]] = defaultdict(list)
    wanted = select(trials).where(trials.c.sweep_id.in_(sweep_ids))
    for row in connection.execute(wanted.order_by(trials.c.sweep_id, trials.c.number)):
        found[row.sweep_id].append(_trial(row))
    return found


def jobs_of(connection: Connection, job_ids: Collection[str]) -> Mapping[str, Job | UnreadableJob]:
    found = connection.execute(select(jobs).where(jobs.c.id.in_(job_ids))).all()
    return {job.id: job for job in loading.of_rows(connection, found)}


def add_trial(connection: Connection, sweep_id: str, trial: Trial, job: Job | None) -> bool:
    """Within a transaction: the lock on the sweep's row makes others wait who add trials, or cancel it."""
    runs = select(sweeps.c.status).where(sweeps.c.id == sweep_id).with_for_update()
    row = connection.execute(runs).first()
    if row is None or row.status != SweepStatus.RUNNING:
        return False
    there = select(trials.c.number).where(trials.c.sweep_id == sweep_id, trials.c.number == trial.number)
    if connection.execute(there).first() is not None:
        return False
    if job is not None:
        if job.spec.source is not None:
            with suppress(JobNotFound):  # Then the trial's attempt says so.
                deletions.hold_source(connection, job.spec.source.job)
        submissions.add(connection, job)
    connection.execute(insert(trials).values(sweep_id=sweep_id, **_trial_values(trial)))
    return True


def save_trial(connection: Connection, sweep_id: str, trial: Trial) -> bool:
    changed = connection.execute(
        update(trials)
        .where(trials.c.sweep_id == sweep_id, trials.c.number == trial.number, trials.c.outcome.is_(None))
        .values(_trial_values(trial))
        .returning(trials.c.number)
    )
    return changed.first() is not None


def _values(sweep: Sweep) -> rows.Values:
    """The columns that change with the version."""
    said = sweep.model_dump(mode="json")
    return {
        "version": sweep.version,
        "status": sweep.status.value,
        "spec": json.dumps(said["spec"]),
        "message": rows.words(sweep.message),
        "finished_at": sweep.finished_at,
        "found": json.dumps({name: said[name] for name in _FOUND}),
    }


def _sweep(row: Row[Any]) -> Sweep:
    """Raises ValueError where another version wrote what this one does not understand."""
    return Sweep.model_validate(
        {**rows.columns(row), **from_json(row.found), "spec": SWEEP_SPEC.validate_json(row.spec)}
    )


def _trial_values(trial: Trial) -> rows.Values:
    return {
        "number": trial.number,
        "job_id": trial.job,
        "outcome": trial.outcome,
        "created_at": trial.created_at,
        "said": trial.model_dump_json(exclude={"number", "job", "outcome", "created_at"}),
    }


def _trial(row: Row[Any]) -> Trial:
    return Trial.model_validate({**from_json(row.said), **rows.columns(row), "job": row.job_id})


def _refuse(connection: Connection, sweep_id: str) -> None:
    if connection.execute(select(sweeps.c.id).where(sweeps.c.id == sweep_id)).first() is None:
        raise SweepNotFound(sweep_id[:64])
    raise StaleSweep(sweep_id)
