"""The jobs of the record, from submission to deletion."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from datetime import timedelta
from functools import cache, partial
from typing import Any

from psycopg.errors import UniqueViolation
from sqlalchemy import (
    Boolean,
    Connection,
    and_,
    any_,
    bindparam,
    delete,
    exists,
    literal,
    or_,
    select,
    union_all,
    update,
)
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.exc import DataError, IntegrityError

from core.accounts.principal import Ownership
from core.adapters.postgres import feeds, leases, listing, quotas, rows, saving, sorting
from core.adapters.postgres.engine import Session
from core.adapters.postgres.tables import (
    HAS_EXPERTS,
    NOW,
    UNFINISHED,
    artifacts,
    attempts,
    chunks,
    deletions,
    dispatches,
    idempotency_keys,
    jobs,
)
from core.errors import (
    ClipsNotFound,
    IdempotencyKeyReused,
    JobExists,
    JobInUse,
    JobNotFound,
    JobUnreadable,
    QuotaExceeded,
)
from core.jobs.job import Attempt, Job, UnreadableJob, check_job_id
from core.jobs.patch import JobPatch, patched
from core.jobs.spec import lenders_of
from core.jobs.status import JobStatus
from core.jobs.store import Chunk, Entry, Idempotency, JobPage, JobQuery, Mark
from core.jobs.uploads import clip_files_of

KEYS_REMEMBERED = timedelta(hours=24)
# Rows of one call, which has two seconds: an import of 5,000 files was refused as an outage.
_AT_ONCE = 500
_JOBS_OF = select(jobs).where(jobs.c.id == any_(rows.IDS))
_MARKS_OF = select(jobs.c.id, jobs.c.version, jobs.c.num_events, jobs.c.num_logs).where(
    jobs.c.id == any_(rows.IDS)
)


class JobQueries(Session):
    """The part of a JobStore that has the jobs themselves."""

    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        # A job that was never tried is one statement.
        is_queued = job.status == JobStatus.QUEUED
        source = job.spec.source if is_queued else None
        is_limited = is_queued and self._limits_queue(job.ownership)
        lenders = lenders_of(job.spec) if is_queued else []
        names_clips = is_queued and bool(clip_files_of(job.spec.environment))
        is_more = bool(job.attempts or job.artifacts or source or lenders or names_clips or is_limited)
        try:
            with self._transaction() if is_more else self._statements() as connection:
                if source is not None and not rows.hold_source(connection, source):
                    raise JobNotFound(source.job)
                for lender in lenders:
                    if not rows.hold_job(connection, lender):
                        raise JobNotFound(lender)
                if names_clips and (gone := rows.hold_clips(connection, job.spec.environment)):
                    raise ClipsNotFound(gone[0])
                if is_limited:
                    quotas.check_queue(connection, job.ownership)
                if add_job(connection, job, idempotency):
                    return job
        except IntegrityError:
            raise JobExists(job.id) from None
        except QuotaExceeded:  # Perhaps because an earlier call with the same key has added it.
            if idempotency is not None and (known := self.remembered(idempotency)) is not None:
                return known
            raise
        assert idempotency is not None  # noqa: S101
        # None if the earlier job was deleted, and its key with it, between the two statements.
        return self.remembered(idempotency) or self.add(job, idempotency)

    def _limits_queue(self, whose: Ownership) -> bool:
        with self._statements() as connection:
            return quotas.limits_queue(connection, whose)

    def import_job(
        self,
        job: Job,
        chunks: Sequence[Chunk],
        events: Sequence[Entry],
        *,
        idempotency: Idempotency | None = None,
    ) -> bool:
        try:
            with self._transaction(is_large=True) as connection:
                if not add_job(connection, job, idempotency):
                    return False
                feeds.add_chunks(connection, job.id, chunks)
                if events:
                    feeds.append(connection, job.id, "events", events)
        except IntegrityError as error:
            if isinstance(error.orig, UniqueViolation):
                return False
            raise
        except DataError as error:  # Such as the character U+0000 in a message.
            raise JobUnreadable(job.id, str(error.orig)) from error
        return True

    def remembered(self, idempotency: Idempotency) -> Job | None:
        known = select(idempotency_keys).where(
            idempotency_keys.c.key_hash == hashed(idempotency), idempotency_keys.c.forgotten_at > NOW
        )
        with self._statements() as connection:
            row = connection.execute(known).first()
            if row is None:
                return None
            if row.fingerprint != idempotency.fingerprint:
                raise IdempotencyKeyReused(idempotency.key)
            return rows.readable(rows.find_job(connection, row.job_id))

    def find(self, job_id: str) -> Job | UnreadableJob:
        with self._statements() as connection:
            return rows.find_job(connection, check_job_id(job_id))

    def get(self, job_id: str) -> Job:
        return rows.readable(self.find(job_id))

    def owner_of(self, job_id: str) -> Ownership:
        wanted = select(jobs.c.owner, jobs.c.project).where(jobs.c.id == check_job_id(job_id))
        with self._statements() as connection:
            row = connection.execute(wanted).first()
        if row is None:
            raise JobNotFound(job_id[:64])
        return Ownership(row.owner, row.project)

    def save(self, job: Job, *, lease: timedelta | None = None, note: str | None = None) -> None:
        with self._transaction() as connection:
            saving.save_job(connection, job, lease=lease, note=note)

    def patch(self, job_id: str, patch: JobPatch) -> Job | UnreadableJob:
        # Two patches wait for each other; whoever names the job in a row of its own does not.
        held = select(jobs.c.spec).where(jobs.c.id == check_job_id(job_id)).with_for_update(key_share=True)
        with self._transaction() as connection:
            row = connection.execute(held).first()
            if row is None:
                raise JobNotFound(job_id)
            if not (before := rows.document(row.spec)):
                raise JobUnreadable(job_id, "its specification is damaged")
            if (spec := patched(before, patch)) != before:
                changed = update(jobs).where(jobs.c.id == job_id)
                connection.execute(changed.values(rows.patch_values(spec, patch)))
            return rows.find_job(connection, job_id)

    def take_back(self, job: Job) -> None:
        with self._transaction() as connection:
            saving.save_job(connection, job, saving.TAKE_BACK)

    def delete(self, job_id: str, version: int) -> None:
        with self._transaction() as connection:
            # With `hold_source`: whoever comes second waits here, and then sees what the first one did.
            connection.execute(select(jobs.c.id).where(jobs.c.id == job_id).with_for_update())
            needed_by = [row.id for row in connection.execute(borrowers_of(job_id))]
            to_come = connection.execute(rows.sweeps_naming(job_id)).scalars().all()
            if needed_by or to_come:
                raise JobInUse(job_id, needed_by, to_come)
            delete_job(connection, job_id, version)

    def deletions(self, *, before: timedelta = timedelta(0)) -> Sequence[str]:
        old = select(deletions.c.job_id).where(deletions.c.begun_at <= NOW - before)
        with self._statements() as connection:
            return connection.execute(old.order_by(deletions.c.job_id)).scalars().all()

    def deletion_ended(self, job_id: str) -> None:
        with self._statements() as connection:
            connection.execute(delete(deletions).where(deletions.c.job_id == job_id))

    def list(
        self, query: JobQuery, *, cursor: str | None = None, limit: int = 50, brief: bool = False
    ) -> JobPage:
        with self._statements() as connection:
            of_newest = None
            if query.sort is not None:
                found, next_cursor, of_newest = sorting.page(connection, query, query.sort, cursor, limit)
            else:
                newest = partial(listing.newest, connection, query)
                found, next_cursor = listing.own_first(newest, query.whose, cursor, limit)
            page = rows.jobs_of_rows(connection, found, brief=brief)
        return JobPage(page, next_cursor, of_newest)

    def jobs_of(self, job_ids: Collection[str]) -> Mapping[str, Job | UnreadableJob]:
        if not job_ids:
            return {}
        with self._statements() as connection:
            found = connection.execute(_JOBS_OF, {"ids": [*job_ids]}).all()
            return {job.id: job for job in rows.jobs_of_rows(connection, found)}

    def marks(self, job_ids: Collection[str]) -> Mapping[str, Mark]:
        with self._statements() as connection:
            found = connection.execute(_MARKS_OF, {"ids": [*job_ids]}).all()
        return {row.id: Mark(row.version, row.num_events, row.num_logs) for row in found}

    def jobs_needing_checkpoint_of(self, job_id: str) -> Sequence[tuple[str, int | None]]:
        with self._statements() as connection:
            return [(row.id, row.source_step) for row in connection.execute(borrowers_of(job_id))]

    def objects_named(self, job_ids: Collection[str]) -> Collection[str]:
        named = [select(table.c.key).where(table.c.job_id.in_(job_ids)) for table in (artifacts, chunks)]
        with self._statements() as connection:
            return set(connection.execute(union_all(*named)).scalars())


def hashed(idempotency: Idempotency) -> str:
    """The hash under which an idempotency key is stored."""
    user, key = idempotency.user, idempotency.key
    # No key has a line break.
    text = key if user is None else f"{user}\n{key}"
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


# ---- A new job: its row, dispatch and key are one statement, which is its own transaction and is built once.
# ---- BEGIN, COMMIT and building it again would take most of a submission's time.


def add_job(connection: Connection, job: Job, idempotency: Idempotency | None = None) -> bool:
    """Add the job with its attempts and artifacts; False if its key is remembered, and nothing was added.

    The second of two submissions with one key waits until the first is committed or rolled back.
    Raises IntegrityError if the id exists.
    """
    row = rows.new_job_values(job)
    values = {**row, "attempt": job.next_attempt, "is_queued": job.status == JobStatus.QUEUED}
    if idempotency is not None:
        values |= {"key_hash": hashed(idempotency), "fingerprint": idempotency.fingerprint}
    statement = _insertion(tuple(row), has_key=idempotency is not None)
    is_new = connection.execute(statement, values).first() is not None
    if is_new:
        _write_attempts(connection, job.id, job.attempts)
        if job.artifacts:
            saving.write_artifacts(connection, job)
    return is_new


@cache
def _insertion(names: tuple[str, ...], *, has_key: bool) -> Any:
    columns = [jobs.c[name] for name in names]
    new = select(*(bindparam(column.name, type_=column.type) for column in columns))
    if has_key:
        new = new.where(exists(select(_new_key().c.job_id)))
    job = insert(jobs).from_select(columns, new).returning(jobs.c.id).cte("job")
    attempt = bindparam("attempt", type_=dispatches.c.attempt.type)
    waits = select(literal("attempt"), job.c.id, attempt, NOW).where(bindparam("is_queued", type_=Boolean))
    dispatch = insert(dispatches).from_select([*dispatches.c], waits).on_conflict_do_nothing()
    return select(job.c.id).add_cte(dispatch.cte("dispatch"))


def _new_key() -> Any:
    key_values: dict[str, Any] = {
        "fingerprint": bindparam("fingerprint"),
        "job_id": bindparam("id"),
        "forgotten_at": NOW + KEYS_REMEMBERED,
    }
    return (
        insert(idempotency_keys)
        .values(key_hash=bindparam("key_hash"), **key_values)
        .on_conflict_do_update(
            index_elements=["key_hash"], set_=key_values, where=idempotency_keys.c.forgotten_at <= NOW
        )
        .returning(idempotency_keys.c.job_id)
        .cte("key")
    )


def _write_attempts(connection: Connection, job_id: str, tried: Sequence[Attempt]) -> None:
    if tried:
        connection.execute(insert(attempts), [rows.attempt_values(job_id, attempt) for attempt in tried])


def delete_job(connection: Connection, job_id: str, version: int) -> None:
    """Delete the job, whose row the caller has locked. Raises JobNotFound, StaleJob."""
    gone = delete(jobs).where(jobs.c.id == job_id, jobs.c.version == version).returning(jobs.c.id)
    if connection.execute(gone).first() is None:
        saving.refuse(connection, job_id)
    leases.forget_dispatch(connection, job_id)
    connection.execute(insert(deletions).values(job_id=job_id, begun_at=NOW))


def borrowers_of(job_id: str) -> Any:
    """The unfinished jobs that need a checkpoint of this one, or its policy: `id`, `source_step`."""
    wanted = select(jobs.c.id, jobs.c.source_step)
    learns = and_(jobs.c.experts.contains([job_id]), HAS_EXPERTS)
    needs = or_(jobs.c.source == job_id, jobs.c.decoder == job_id, learns)
    return wanted.where(jobs.c.status.in_(UNFINISHED), needs).order_by(jobs.c.id)
