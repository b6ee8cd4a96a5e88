"""The record in PostgreSQL."""

from collections import defaultdict
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from itertools import islice
from typing import Any, NoReturn

import structlog
from psycopg.errors import UniqueViolation
from sqlalchemy import (
    ARRAY,
    Connection,
    Engine,
    Text,
    and_,
    any_,
    bindparam,
    case,
    delete,
    exists,
    not_,
    or_,
    select,
    union_all,
    update,
)
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.exc import DataError, IntegrityError

from core.adapters.cursors import check_cursor
from core.adapters.entries import status_entry
from core.adapters.postgres import addition, feeds, listing, models, rows
from core.adapters.postgres.clock import Clock
from core.adapters.postgres.errors import Breaker
from core.adapters.postgres.tables import (
    NOW,
    UNFINISHED,
    artifacts,
    attempts,
    chunks,
    dispatches,
    idempotency_keys,
    jobs,
    pulse,
    workers,
)
from core.errors import IdempotencyKeyReused, JobExists, JobNotFound, JobUnreadable, LeaseLost, StaleJob
from core.jobs.attempts import PAUSES
from core.jobs.job import Attempt, Job, Progress, UnreadableJob, check_job_id, utc_now
from core.jobs.status import JobStatus
from core.jobs.store import (
    Channel,
    Chunk,
    Dispatch,
    Entry,
    FeedPart,
    Idempotency,
    JobQuery,
    Mark,
    Page,
    WorkerInfo,
)
from core.user_models.record import ModelRecord

log = structlog.get_logger()

_HELD = tuple(status.value for status in JobStatus if status.is_held)
# Built once: these are a part of every submission and every claim.
_SELECT_NOW = select(NOW)
_DISPATCHED = delete(dispatches).where(
    dispatches.c.task == bindparam("task"),
    dispatches.c.subject == bindparam("subject"),
    dispatches.c.attempt == bindparam("attempt"),
)
# An array is one parameter: the statement is the same for any number of ids, and PostgreSQL has it prepared.
_IDS = bindparam("ids", type_=ARRAY(Text))
_ATTEMPTS_OF = select(attempts).where(attempts.c.job_id == any_(_IDS)).order_by(attempts.c.number)
_ARTIFACTS_OF = select(artifacts).where(artifacts.c.job_id == any_(_IDS)).order_by(artifacts.c.position)
_MARKS_OF = select(jobs.c.id, jobs.c.version, jobs.c.num_events, jobs.c.num_logs).where(
    jobs.c.id == any_(_IDS)
)
# So many entries at once take a fraction of a call's time limit.
_BATCH = 1000


@dataclass(frozen=True)
class SeenKey:
    """The idempotency key of an earlier submission, by its hash. left: how long it is remembered."""

    key_hash: str
    fingerprint: str
    left: timedelta


class PostgresJobStore:
    """A JobStore for many processes; thread-safe. The engine is `connect_postgres`'s.

    clock_age: how long `now` counts on from the database's last answer.
    """

    def __init__(self, engine: Engine, *, clock_age: timedelta = timedelta(seconds=1)) -> None:
        self._engine = engine
        self._autocommit = engine.execution_options(isolation_level="AUTOCOMMIT")
        self._breaker = Breaker()
        self._clock = Clock(self._time, clock_age)

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()

    def now(self) -> datetime:
        return self._clock.now()

    # ---- jobs ------------------------------------------------------------------------------------

    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        try:
            # A job that was never tried is one statement.
            has_past = bool(job.attempts or job.artifacts)
            with self._transaction() if has_past else self._statements() as connection:
                if _insert(connection, job, idempotency):
                    return job
        except IntegrityError:
            raise JobExists(job.id) from None
        assert idempotency is not None  # noqa: S101
        # Forgotten between the two: the earlier job was deleted.
        return self.remembered(idempotency) or self.add(job, idempotency)

    def import_job(
        self, job: Job, events: Iterable[Entry], logs: Iterable[Entry], keys: Sequence[SeenKey] = ()
    ) -> bool:
        """Store a job of an earlier version, ended or queued, with its feeds and the keys of its submission.

        All of it or nothing; whether it was not there yet. Raises JobUnreadable where PostgreSQL refuses it.
        """
        try:
            with self._transaction() as connection:
                _insert(connection, job)
                _append_all(connection, job.id, "events", events)
                _append_all(connection, job.id, "logs", logs)
                for key in keys:
                    _remember_seen(connection, key, job.id)
        except IntegrityError as error:
            if isinstance(error.orig, UniqueViolation):
                return False
            raise
        except DataError as error:  # Such as the character U+0000 in a message.
            raise JobUnreadable(job.id, str(error.orig)) from error
        return True

    def remembered(self, idempotency: Idempotency) -> Job | None:
        with self._statements() as connection:
            job_id = _remembered(connection, idempotency)
            return None if job_id is None else _readable(_load(connection, job_id))

    def find(self, job_id: str) -> Job | UnreadableJob:
        with self._statements() as connection:
            return _load(connection, check_job_id(job_id))

    def get(self, job_id: str) -> Job:
        return _readable(self.find(job_id))

    def save(self, job: Job, *, lease: timedelta | None = None) -> None:
        self._save(job, lease=lease)

    def take_back(self, job: Job) -> None:
        self._save(job, _lease_is_over())

    def delete(self, job_id: str, version: int) -> None:
        with self._transaction() as connection:
            found = connection.execute(
                delete(jobs).where(jobs.c.id == job_id, jobs.c.version == version).returning(jobs.c.id)
            )
            if found.first() is None:
                _refuse(connection, job_id)
            _forget_dispatch(connection, job_id)

    def list(self, query: JobQuery, *, cursor: str | None = None, limit: int = 50) -> Page:
        before = None if cursor is None else check_cursor(cursor)
        with self._statements() as connection:
            found = _load_all(connection, listing.newest(connection, query, before, limit + 1))
        return Page(found[:limit], found[limit - 1].id if len(found) > limit else None)

    def users_of(self, model_id: str) -> Sequence[str]:
        with self._statements() as connection:
            wanted = select(jobs.c.id).where(jobs.c.status.in_(UNFINISHED), jobs.c.model == model_id)
            return connection.execute(wanted.order_by(jobs.c.id)).scalars().all()

    def borrowers_of(self, job_id: str) -> Sequence[tuple[str, int | None]]:
        wanted = select(jobs.c.id, jobs.c.source_step).where(
            jobs.c.status.in_(UNFINISHED), jobs.c.source == job_id
        )
        with self._statements() as connection:
            return [(row.id, row.source_step) for row in connection.execute(wanted.order_by(jobs.c.id))]

    def objects_named(self, job_ids: Collection[str]) -> Collection[str]:
        named = [select(table.c.key).where(table.c.job_id.in_(job_ids)) for table in (artifacts, chunks)]
        with self._statements() as connection:
            return set(connection.execute(union_all(*named)).scalars())

    def uncopied(self, *, limit: int) -> Sequence[Job | UnreadableJob]:
        wanted = select(jobs).where(jobs.c.copied_version != jobs.c.version, jobs.c.num_attempts > 0)
        with self._statements() as connection:
            return _load_all(connection, connection.execute(wanted.order_by(jobs.c.id).limit(limit)).all())

    def copied(self, job_id: str, version: int) -> bool:
        marked = update(jobs).where(jobs.c.id == job_id).values(copied_version=version).returning(jobs.c.id)
        with self._statements() as connection:
            return connection.execute(marked).first() is not None

    # ---- after a disaster ------------------------------------------------------------------------

    def chunks(self, job_ids: Collection[str]) -> Mapping[str, Sequence[Chunk]]:
        with self._statements() as connection:
            return feeds.chunks_of(connection, job_ids)

    def restore(self, job: Job, *, replaces: int | None, note: str, chunks: Sequence[Chunk] = ()) -> None:
        said = [Entry(kind="note", time=utc_now(), data={"text": note})]
        try:
            with self._transaction() as connection:
                if replaces is None:
                    connection.execute(insert(jobs).values(rows.new_job_values(job)))
                elif _replace(connection, job, replaces).status != job.status:
                    said.append(status_entry(job))
                _write_attempts(connection, job.id, job.attempts)
                _write_artifacts(connection, job)
                feeds.adopt(connection, job.id, chunks)
                feeds.append(connection, job.id, "events", said, job.progress)
                _update_dispatch(connection, job)
        except IntegrityError:
            raise JobExists(job.id) from None

    def replace_chunk(self, job_id: str, lost: Chunk, found: Chunk) -> None:
        with self._transaction() as connection:
            feeds.replace_chunk(connection, job_id, lost, found)

    # ---- leases ----------------------------------------------------------------------------------

    def renew(self, job_id: str, token: str, lease: timedelta) -> JobStatus:
        with self._statements() as connection:
            status = connection.execute(
                update(jobs)
                .where(jobs.c.id == job_id, jobs.c.token == token, jobs.c.token != "")
                .values(lease_until=NOW + rows.interval(lease))
                .returning(jobs.c.status)
            ).scalar()
        if status is None:
            raise LeaseLost(job_id)
        return JobStatus(status)

    def expired(self) -> Iterable[Job]:
        wanted = select(jobs).where(jobs.c.status.in_(_HELD), _lease_is_over()).order_by(jobs.c.id)
        with self._statements() as connection:
            found = _load_all(connection, connection.execute(wanted).all())
        return _without_unreadable(found)

    def beat(self, lease: timedelta) -> None:
        silence = NOW - pulse.c.beat_at
        was_away = or_(silence > lease / 2, silence < timedelta(0))
        longest, quiet_until = rows.interval(lease / 2), NOW + rows.interval(lease)
        with self._transaction() as connection:
            connection.execute(
                # Whoever empties all tables takes the row along.
                insert(pulse)
                .values(id=1, beat_at=NOW, longest_silence=longest, quiet_until=quiet_until)
                .on_conflict_do_update(
                    index_elements=["id"],
                    set_={
                        "beat_at": NOW,
                        "longest_silence": longest,
                        "quiet_until": case((was_away, quiet_until), else_=pulse.c.quiet_until),
                    },
                )
            )
            # The clock was set back: no lease reaches further than a lease from now.
            connection.execute(
                update(jobs)
                .where(jobs.c.status.in_(_HELD), jobs.c.lease_until > NOW + 4 * lease)
                .values(lease_until=NOW + rows.interval(lease))
            )

    # ---- dispatches ------------------------------------------------------------------------------

    def waiting(self) -> Sequence[Dispatch]:
        queued = select(jobs.c.id, jobs.c.num_attempts + 1).where(jobs.c.status == "queued", _is_due())
        with self._statements() as connection:
            found = [Dispatch("attempt", *row) for row in connection.execute(queued.order_by(jobs.c.id))]
            return [*found, *models.waiting(connection)]

    def undispatched(self) -> Sequence[Dispatch]:
        of_jobs = dispatches.outerjoin(jobs, dispatches.c.subject.collate("C") == jobs.c.id)
        wanted = select(dispatches).select_from(of_jobs).where(_is_due())
        wanted = wanted.order_by(dispatches.c.created_at).limit(1000)
        with self._statements() as connection:
            return [Dispatch(row.task, row.subject, row.attempt) for row in connection.execute(wanted)]

    def dispatched(self, dispatches: Sequence[Dispatch]) -> None:
        if dispatches:
            with self._statements() as connection:
                connection.execute(_DISPATCHED, [asdict(dispatch) for dispatch in dispatches])

    # ---- feeds -----------------------------------------------------------------------------------

    def record(  # As in the seam.
        self,
        job_id: str,
        token: str,
        channel: Channel,
        entries: Sequence[Entry],
        progress: Progress | None = None,
        *,
        write_id: str,
    ) -> None:
        with self._statements() as connection:
            if not feeds.append_as_attempt(connection, job_id, token, channel, entries, progress, write_id):
                raise LeaseLost(job_id)

    def feed(self, job_id: str, channel: Channel, *, after: int = 0, limit: int = 1000) -> FeedPart:
        with self._statements() as connection:
            found = feeds.read(connection, job_id, channel, after, limit)
        if found is None:
            raise JobNotFound(job_id[:64])
        return found

    def long_feeds(self, *, max_bytes: int, max_age: timedelta) -> Sequence[tuple[str, Channel]]:
        with self._transaction() as connection:
            return feeds.due(connection, max_bytes, max_age)

    def oldest_entries(self, job_id: str, channel: Channel, *, limit: int) -> Sequence[Entry]:
        with self._statements() as connection:
            return feeds.oldest(connection, job_id, channel, limit)

    def replace_by_chunk(self, job_id: str, chunk: Chunk) -> None:
        with self._transaction() as connection:
            feeds.replace_by_chunk(connection, job_id, chunk)

    def marks(self, job_ids: Collection[str]) -> Mapping[str, Mark]:
        with self._statements() as connection:
            found = connection.execute(_MARKS_OF, {"ids": list(job_ids)})
            return {row.id: Mark(row.version, row.num_events, row.num_logs) for row in found}

    # ---- models ----------------------------------------------------------------------------------

    def find_model(self, model_id: str) -> ModelRecord:
        with self._statements() as connection:
            return models.find(connection, model_id)

    def add_model(self, record: ModelRecord) -> None:
        with self._transaction() as connection:
            models.add(connection, record)

    def model_dispatched(self, model_id: str) -> None:
        self.dispatched([Dispatch("model", model_id)])

    def settle_model(self, record: ModelRecord) -> None:
        with self._transaction() as connection:
            models.settle(connection, record)

    def delete_model(self, model_id: str) -> None:
        with self._transaction() as connection:
            models.forget(connection, model_id)

    def num_waiting_models(self) -> int:
        with self._statements() as connection:
            return len(models.waiting(connection))

    def models(self) -> Sequence[ModelRecord]:
        with self._statements() as connection:
            return models.every(connection)

    # ---- workers ---------------------------------------------------------------------------------

    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        said = {"said": worker.model_dump_json(), "gone_at": NOW + rows.interval(ttl)}
        with self._statements() as connection:
            connection.execute(
                insert(workers)
                .values(name=worker.name, **said)
                .on_conflict_do_update(index_elements=["name"], set_=said)
            )

    def withdraw(self, name: str) -> None:
        with self._statements() as connection:
            connection.execute(delete(workers).where(workers.c.name == name))

    def workers(self) -> Sequence[WorkerInfo]:
        wanted = select(workers.c.said).where(workers.c.gone_at > NOW).order_by(workers.c.name)
        with self._statements() as connection:
            said = connection.execute(wanted).scalars().all()
        return rows.read_workers(said)

    def tidy(self) -> None:
        with self._transaction() as connection:
            connection.execute(delete(idempotency_keys).where(idempotency_keys.c.forgotten_at <= NOW))
            connection.execute(delete(workers).where(workers.c.gone_at <= NOW))

    def ping(self) -> None:
        with self._statements() as connection:
            connection.execute(select(pulse.c.id))

    # ---- inside ----------------------------------------------------------------------------------

    def _time(self) -> datetime:
        with self._statements() as connection:
            return connection.execute(_SELECT_NOW).scalar_one()

    @contextmanager
    def _transaction(self) -> Generator[Connection]:
        with self._breaker.reaching(), self._engine.connect() as connection, connection.begin():
            yield connection

    @contextmanager
    def _statements(self) -> Generator[Connection]:
        """Each statement is a transaction by itself; that saves the round trips of BEGIN and COMMIT."""
        with self._breaker.reaching(), self._autocommit.connect() as connection:
            yield connection

    def _save(self, job: Job, *conditions: Any, lease: timedelta | None = None) -> None:
        with self._transaction() as connection:
            before = _replace(connection, job, job.version - 1, *conditions, lease=lease)
            # A step changes the last attempt, or the one before it.
            _write_attempts(connection, job.id, job.attempts[-2:])
            if job.artifacts or before.has_artifacts:
                _write_artifacts(connection, job)
            if before.status != job.status:
                feeds.append(connection, job.id, "events", [status_entry(job)])
            if JobStatus.QUEUED in (before.status, job.status):
                _update_dispatch(connection, job)


def _replace(
    connection: Connection, job: Job, version: int, *conditions: Any, lease: timedelta | None = None
) -> Any:
    """Write the job's own row in the place of this version; the `status` that was there, and `has_artifacts`.

    Raises StaleJob, JobNotFound.
    """
    values = rows.job_values(job)
    # A lease is the present attempt's; a change of hands ends the one before.
    same_holder = jobs.c.token == job.token
    kept = case((same_holder, jobs.c.lease_until), else_=None) if job.token else None
    values["lease_until"] = NOW + rows.interval(lease) if lease is not None and job.token else kept
    before = select(jobs.c.status).where(jobs.c.id == job.id).scalar_subquery()
    has_artifacts = exists().where(artifacts.c.job_id == job.id)
    changed = connection.execute(
        update(jobs)
        .where(jobs.c.id == job.id, jobs.c.version == version, *conditions)
        .values(values)
        .returning(before.label("status"), has_artifacts.label("has_artifacts"))
    ).first()
    if changed is None:
        _refuse(connection, job.id)
    return changed


def _insert(connection: Connection, job: Job, idempotency: Idempotency | None = None) -> bool:
    """Whether it was added; not where its key is remembered."""
    is_new = addition.add(connection, job, idempotency)
    if is_new:
        _write_attempts(connection, job.id, job.attempts)
        if job.artifacts:
            _write_artifacts(connection, job)
    return is_new


def _append_all(connection: Connection, job_id: str, channel: Channel, entries: Iterable[Entry]) -> None:
    """However many there are."""
    left = iter(entries)
    while batch := list(islice(left, _BATCH)):
        feeds.append(connection, job_id, channel, batch)


def _write_attempts(connection: Connection, job_id: str, changed: Sequence[Attempt]) -> None:
    if not changed:
        return
    statement = insert(attempts)
    changes = {
        column.name: statement.excluded[column.name] for column in attempts.c if not column.primary_key
    }
    connection.execute(
        statement.on_conflict_do_update(index_elements=["job_id", "number"], set_=changes),
        [rows.attempt_values(job_id, attempt) for attempt in changed],
    )


def _write_artifacts(connection: Connection, job: Job) -> None:
    stored = connection.execute(
        select(artifacts.c.name, artifacts.c.position, artifacts.c.key).where(artifacts.c.job_id == job.id)
    ).all()
    have = {row.name: row for row in stored}
    if gone := have.keys() - {artifact.name for artifact in job.artifacts}:
        connection.execute(delete(artifacts).where(artifacts.c.job_id == job.id, artifacts.c.name.in_(gone)))
    top = max((row.position for row in stored), default=0)
    new: list[rows.Values] = []
    for artifact in job.artifacts:
        known = have.get(artifact.name)
        if known is None:
            top += 1
        if known is None or known.key != artifact.key:
            new.append(rows.artifact_values(job.id, top if known is None else known.position, artifact))
    if new:
        statement = insert(artifacts)
        changes = {name: statement.excluded[name] for name in new[0] if name not in ("job_id", "name")}
        connection.execute(
            statement.on_conflict_do_update(index_elements=["job_id", "name"], set_=changes), new
        )


def _update_dispatch(connection: Connection, job: Job) -> None:
    """A job that waits for a worker is to be dispatched; any other is not."""
    if job.status == JobStatus.QUEUED:
        connection.execute(
            insert(dispatches)
            .values(task="attempt", subject=job.id, attempt=job.next_attempt, created_at=NOW)
            .on_conflict_do_nothing()
        )
    else:
        _forget_dispatch(connection, job.id)


def _forget_dispatch(connection: Connection, job_id: str) -> None:
    connection.execute(
        delete(dispatches).where(dispatches.c.task == "attempt", dispatches.c.subject == job_id)
    )


def _refuse(connection: Connection, job_id: str) -> NoReturn:
    if connection.execute(select(jobs.c.id).where(jobs.c.id == job_id)).first() is None:
        raise JobNotFound(job_id[:64])
    raise StaleJob(job_id)


def _is_due() -> Any:
    """Whether a job may be tried now. One that is too far off is older than a step of the clock."""
    not_yet = and_(jobs.c.not_before > NOW, jobs.c.not_before <= NOW + max(PAUSES))
    return or_(jobs.c.not_before.is_(None), not_(not_yet))


def _lease_is_over() -> Any:
    """Whether a held job may be taken from its attempt.

    Not in a silence, nor right after one that began behind the last beat: nobody could renew meanwhile.
    """
    is_watched = and_(pulse.c.quiet_until < NOW, NOW - pulse.c.beat_at <= pulse.c.longest_silence)
    is_over = or_(jobs.c.lease_until.is_(None), jobs.c.lease_until < NOW)
    return and_(is_over, select(is_watched).scalar_subquery())


def _load(connection: Connection, job_id: str) -> Job | UnreadableJob:
    row = connection.execute(select(jobs).where(jobs.c.id == job_id)).first()
    if row is None:
        raise JobNotFound(job_id[:64])
    return _load_all(connection, [row])[0]


def _load_all(connection: Connection, found: Sequence[Any]) -> list[Job | UnreadableJob]:
    """The jobs of these rows, with at most two queries for all of them together."""
    if not found:
        return []
    ids = {"ids": [row.id for row in found]}
    tries: dict[str, list[Any]] = defaultdict(list)
    files: dict[str, list[Any]] = defaultdict(list)
    if any(row.num_attempts for row in found):
        for row in connection.execute(_ATTEMPTS_OF, ids):
            tries[row.job_id].append(row)
    for row in connection.execute(_ARTIFACTS_OF, ids):
        files[row.job_id].append(row)
    return [rows.read_job(row, tries[row.id], files[row.id]) for row in found]


def _readable(job: Job | UnreadableJob) -> Job:
    if isinstance(job, UnreadableJob):
        raise JobUnreadable(job.id, job.problem)
    return job


def _without_unreadable(found: Iterable[Job | UnreadableJob]) -> list[Job]:
    for job in found:
        if isinstance(job, UnreadableJob):
            log.warning("job_unreadable", job_id=job.id, problem=job.problem)
    return [job for job in found if isinstance(job, Job)]


def _remembered(connection: Connection, idempotency: Idempotency) -> str | None:
    row = connection.execute(
        select(idempotency_keys).where(
            idempotency_keys.c.key_hash == addition.hashed(idempotency.key),
            idempotency_keys.c.forgotten_at > NOW,
        )
    ).first()
    if row is None:
        return None
    if row.fingerprint != idempotency.fingerprint:
        raise IdempotencyKeyReused(idempotency.key)
    return row.job_id


def _remember_seen(connection: Connection, key: SeenKey, job_id: str) -> None:
    """Unless somebody has used the key since."""
    connection.execute(
        insert(idempotency_keys)
        .values(
            key_hash=key.key_hash,
            fingerprint=key.fingerprint,
            job_id=job_id,
            forgotten_at=NOW + key.left,
        )
        .on_conflict_do_nothing()
    )
