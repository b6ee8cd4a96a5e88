"""The records of sweeps and of their trials."""

import json
import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NoReturn

import structlog
from pydantic_core import from_json
from sqlalchemy import ColumnElement, Connection, Row, and_, any_, delete, func, literal, select, update
from sqlalchemy.dialects.postgresql import aggregate_order_by, insert

from core.accounts.principal import Ownership
from core.adapters.postgres import listing, news, quotas, rows
from core.adapters.postgres.engine import Session
from core.adapters.postgres.jobs import KEYS_REMEMBERED, add_job, hashed
from core.adapters.postgres.listing import Part
from core.adapters.postgres.tables import NOW, jobs, sweeps, trials
from core.errors import IdempotencyKeyReused, JobNotFound, StaleSweep, SweepNotFound, TooManySweeps
from core.jobs.job import JOB_ID, Job
from core.jobs.spec import lenders_of
from core.jobs.store import ANYBODYS, Idempotency, Whose
from core.sweeps.news import news_of_sweep
from core.sweeps.spec import SWEEP_SPEC
from core.sweeps.sweep import Sweep, SweepMark, SweepPage, SweepStatus, Trial

log = structlog.get_logger()

_RESULTS = {"importance", "importance_note", "num_judged"}
_ACTIVE = ("running", "cancelling")
_SWEEPS_OF = select(trials.c.job_id, trials.c.sweep_id).where(trials.c.job_id == any_(rows.IDS))


class SweepQueries(Session):
    """The part of a SweepStore that has the sweeps."""

    def add_sweep(
        self, sweep: Sweep, idempotency: Idempotency | None = None, *, most_active: int | None = None
    ) -> Sweep:
        with self._transaction() as connection:
            stored = _add(connection, sweep, idempotency, most_active)
            if stored is sweep:  # No earlier one of this key.
                _hold_source(connection, sweep)
            return stored

    def remembered_sweep(self, idempotency: Idempotency) -> Sweep | None:
        is_remembered = sweeps.c.created_at > NOW - KEYS_REMEMBERED
        with self._statements() as connection:
            return _of_key(connection, idempotency, is_remembered)

    def num_active_sweeps(self) -> int:
        with self._statements() as connection:
            return _num_active(connection)

    def get_sweep(self, sweep_id: str) -> Sweep:
        with self._statements() as connection:
            row = connection.execute(select(sweeps).where(sweeps.c.id == sweep_id)).first()
        if row is None:
            raise SweepNotFound(sweep_id[:64])
        return _sweep(row)

    def owner_of_sweep(self, sweep_id: str) -> Ownership:
        wanted = select(sweeps.c.owner, sweeps.c.project).where(sweeps.c.id == sweep_id)
        if re.fullmatch(JOB_ID, sweep_id) is None:
            raise SweepNotFound(sweep_id[:64])
        with self._statements() as connection:
            row = connection.execute(wanted).first()
        if row is None:
            raise SweepNotFound(sweep_id[:64])
        return Ownership(row.owner, row.project)

    def save_sweep(self, sweep: Sweep) -> None:
        before = update(sweeps).where(sweeps.c.id == sweep.id, sweeps.c.version == sweep.version - 1)
        status = select(sweeps.c.status).where(sweeps.c.id == sweep.id).scalar_subquery().label("status")
        with self._transaction() as connection:
            row = connection.execute(before.values(_values(sweep)).returning(status)).first()
            if row is None:
                _refuse(connection, sweep.id)
            if row.status != sweep.status:
                if sweep.status == SweepStatus.RUNNING:
                    _hold_source(connection, sweep)
                news.add(connection, news_of_sweep(sweep))

    def delete_sweep(self, sweep_id: str, version: int) -> None:
        known = delete(sweeps).where(sweeps.c.id == sweep_id, sweeps.c.version == version)
        with self._statements() as connection:
            if connection.execute(known.returning(sweeps.c.id)).first() is None:
                _refuse(connection, sweep_id)

    def list_sweeps(
        self,
        *,
        ids: Collection[str] | None = None,
        status: SweepStatus | None = None,
        whose: Whose = ANYBODYS,
        cursor: str | None = None,
        limit: int = 50,
    ) -> SweepPage:
        conditions = [] if status is None else [sweeps.c.status == status.value]
        if ids is not None:
            conditions.append(sweeps.c.id.in_(ids))
        trial_bytes = select(func.coalesce(func.sum(func.octet_length(trials.c.document)), 0)).where(
            trials.c.sweep_id == sweeps.c.id
        )
        size = func.octet_length(sweeps.c.spec) + trial_bytes.scalar_subquery()
        with self._statements() as connection:

            def newest(part: Part, before: str | None, most: int) -> Sequence[Row[Any]]:
                matches = [*conditions, *listing.of(sweeps, whose, part), *listing.below(sweeps, before)]
                wanted = select(sweeps).where(*matches).order_by(sweeps.c.id.desc()).limit(most)
                return connection.execute(listing.by_bytes(wanted, size, "id")).all()

            found, next_cursor = listing.own_first(newest, whose, cursor, limit)
        return SweepPage(_readable(found), next_cursor)

    def sweeps_of(self, job_ids: Collection[str]) -> Mapping[str, str]:
        if not job_ids:
            return {}
        with self._statements() as connection:
            found = connection.execute(_SWEEPS_OF, {"ids": [*job_ids]}).all()
        return {row.job_id: row.sweep_id for row in found}

    def active_marks(self) -> Mapping[str, SweepMark]:
        # Only those trials are read that have not ended, by the index `trials_going`.
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
        with self._statements() as connection:
            found = connection.execute(wanted).all()
        return {row.id: SweepMark(row.version, row.going, row.events) for row in found}

    def active_sweeps(self, among: Collection[str] | None = None) -> Sequence[Sweep]:
        wanted = select(sweeps).where(sweeps.c.status.in_(_ACTIVE)).order_by(sweeps.c.id)
        if among is not None:
            wanted = wanted.where(sweeps.c.id.in_(among))
        with self._statements() as connection:
            return _readable(connection.execute(wanted).all())

    def trials(self, sweep_ids: Collection[str]) -> Mapping[str, Sequence[Trial]]:
        if not sweep_ids:
            return {}
        found: dict[str, list[Trial]] = defaultdict(list)
        wanted = select(trials).where(trials.c.sweep_id.in_(sweep_ids))
        with self._statements() as connection:
            for row in connection.execute(wanted.order_by(trials.c.sweep_id, trials.c.number)):
                found[row.sweep_id].append(_trial(row))
        return found

    def add_trial(self, sweep_id: str, trial: Trial, job: Job | None) -> bool:
        # The lock on the sweep's row makes others wait who add trials, or cancel it.
        runs = select(sweeps.c.status).where(sweeps.c.id == sweep_id).with_for_update()
        there = select(trials.c.number).where(trials.c.sweep_id == sweep_id, trials.c.number == trial.number)
        with self._transaction() as connection:
            row = connection.execute(runs).first()
            if row is None or row.status != SweepStatus.RUNNING:
                return False
            if connection.execute(there).first() is not None:
                return False
            if job is not None:
                if job.spec.source is not None:
                    # Where the source was deleted, the trial's attempt says so.
                    rows.hold_job(connection, job.spec.source.job)
                for lender in lenders_of(job.spec):
                    rows.hold_job(connection, lender)
                rows.hold_clips(connection, job.spec.environment)
                quotas.check_queue(connection, job.ownership)
                add_job(connection, job)
            connection.execute(insert(trials).values(sweep_id=sweep_id, **_trial_values(trial)))
            return True

    def save_trial(self, sweep_id: str, trial: Trial) -> bool:
        open_trial = update(trials).where(
            trials.c.sweep_id == sweep_id, trials.c.number == trial.number, trials.c.outcome.is_(None)
        )
        changed = open_trial.values(_trial_values(trial)).returning(trials.c.number)
        with self._statements() as connection:
            return connection.execute(changed).first() is not None


def _add(
    connection: Connection, sweep: Sweep, idempotency: Idempotency | None, most_active: int | None
) -> Sweep:
    has_room = most_active is None or _num_active(connection) < most_active
    values = {**_values(sweep), "id": sweep.id, "created_at": sweep.created_at}
    values |= {"owner": sweep.owner, "project": sweep.project}
    if idempotency is None:
        _check_room(most_active, has_room=has_room)
        connection.execute(insert(sweeps).values(values))
        return sweep
    key_hash = hashed(idempotency)
    is_forgotten = sweeps.c.created_at <= NOW - KEYS_REMEMBERED
    connection.execute(
        update(sweeps)
        .where(sweeps.c.key_hash == key_hash, is_forgotten)
        .values(key_hash=None, fingerprint=None)
    )
    values |= {"key_hash": key_hash, "fingerprint": idempotency.fingerprint}
    new = insert(sweeps).values(values).on_conflict_do_nothing(index_elements=["key_hash"])
    if connection.execute(new.returning(sweeps.c.id)).first() is not None:
        _check_room(most_active, has_room=has_room)  # The insertion is rolled back.
        return sweep
    # None if it was deleted between the two statements.
    return _of_key(connection, idempotency) or _add(connection, sweep, idempotency, most_active)


def _hold_source(connection: Connection, sweep: Sweep) -> None:
    """Of a job whose checkpoint all trials need: whoever removes it comes after this, and sees the sweep.

    Where only some need one, their attempts say what is gone. Raises JobNotFound.
    """
    source = sweep.spec.job.source
    if source is None or source.pointer[1:] in {name.partition(".")[0] for name in sweep.spec.parameters}:
        return
    if not rows.hold_source(connection, source):
        raise JobNotFound(source.job)


def _of_key(connection: Connection, idempotency: Idempotency, *conditions: Any) -> Sweep | None:
    """Raises IdempotencyKeyReused."""
    its = select(sweeps).where(sweeps.c.key_hash == hashed(idempotency), *conditions)
    row = connection.execute(its).first()
    if row is None:
        return None
    if row.fingerprint != idempotency.fingerprint:
        raise IdempotencyKeyReused(idempotency.key)
    return _sweep(row)


def _check_room(most_active: int | None, *, has_room: bool) -> None:
    if most_active is not None and not has_room:
        raise TooManySweeps(most_active)


def _num_active(connection: Connection) -> int:
    wanted = select(func.count()).select_from(sweeps).where(sweeps.c.status.in_(_ACTIVE))
    return connection.execute(wanted).scalar_one()


def _digest(*columns: ColumnElement[Any]) -> ColumnElement[Any]:
    """A digest over all rows of a group; null for a group without trials."""
    row = func.concat_ws(" ", *columns)
    return func.md5(func.string_agg(row, aggregate_order_by(literal(","), trials.c.number)))


def _values(sweep: Sweep) -> rows.Values:
    """The columns that change with the version."""
    document = sweep.model_dump(mode="json")
    return {
        "version": sweep.version,
        "status": sweep.status.value,
        "spec": json.dumps(document["spec"]),
        "message": rows.words(sweep.message),
        "finished_at": sweep.finished_at,
        "results": json.dumps({name: document[name] for name in _RESULTS}),
    }


def _sweep(row: Row[Any]) -> Sweep:
    """Raises ValueError where another version wrote what this one does not understand."""
    return Sweep.model_validate(
        {**rows.columns(row), **from_json(row.results), "spec": SWEEP_SPEC.validate_json(row.spec)}
    )


def _readable(found: Sequence[Row[Any]]) -> list[Sweep]:
    """Those that can be read, in their order; the log names the others."""
    readable: list[Sweep] = []
    for row in found:
        try:
            readable.append(_sweep(row))
        except ValueError as error:  # A newer version may have written it.
            log.warning("sweep_unreadable", sweep=row.id, problem=str(error))
    return readable


def _trial_values(trial: Trial) -> rows.Values:
    return {
        "number": trial.number,
        "job_id": trial.job,
        "outcome": trial.outcome,
        "created_at": trial.created_at,
        "document": trial.model_dump_json(exclude={"number", "job", "outcome", "created_at"}),
    }


def _trial(row: Row[Any]) -> Trial:
    return Trial.model_validate({**from_json(row.document), **rows.columns(row), "job": row.job_id})


def _refuse(connection: Connection, sweep_id: str) -> NoReturn:
    if connection.execute(select(sweeps.c.id).where(sweeps.c.id == sweep_id)).first() is None:
        raise SweepNotFound(sweep_id[:64])
    raise StaleSweep(sweep_id)
