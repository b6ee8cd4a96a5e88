"""A job's feeds: numbered entries; the older ones lie in chunks in the object store."""

import json
from collections import defaultdict
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import timedelta
from tempfile import TemporaryFile
from typing import Any

from pydantic_core import from_json, to_json
from sqlalchemy import Column, Connection, TextClause, delete, func, or_, select, text, update
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import rows
from core.adapters.postgres.engine import Session
from core.adapters.postgres.tables import NOW, UNFINISHED, chunks, entries, jobs
from core.errors import JobNotFound, LeaseLost, StorageUnavailable
from core.jobs.job import Progress
from core.jobs.measured import in_rows
from core.jobs.store import Channel, Chunk, Entry, FeedPart, MeasuredPart

# Kinds, times and data of entries.
_Batch = tuple[list[str], list[str], list[str]]
_NUM: dict[Channel, Column[int]] = {"events": jobs.c.num_events, "logs": jobs.c.num_logs}
_INSERT = """
    INSERT INTO entries (job_id, channel, number, kind, time, data)
    SELECT :job_id, :channel, last_before + place, said.kind, said.time, said.data
    FROM grown, unnest(CAST(:kinds AS text[]), CAST(:times AS timestamptz[]), CAST(:data AS text[]))
         WITH ORDINALITY AS said (kind, time, data, place)
"""
# Writing to a feed and reading it are one statement each: most of the time went into round trips.
_APPEND: dict[Channel, TextClause] = {
    channel: text(f"""
        WITH grown AS (
            UPDATE jobs
            SET {counter.name} = {counter.name} + :count, progress = coalesce(:progress, progress)
            WHERE id = :job_id
            RETURNING {counter.name} - :count AS last_before
        )
        {_INSERT}
    """)  # noqa: S608 # Names of columns.
    for channel, counter in _NUM.items()
}
# PostgreSQL checks `held`'s condition again after waiting for the row: its holder may have changed.
_APPEND_AS_ATTEMPT: dict[Channel, TextClause] = {
    channel: text(f"""
        WITH held AS (
            SELECT id, last_write FROM jobs WHERE id = :job_id AND token = :token AND token <> '' FOR UPDATE
        ), grown AS (
            UPDATE jobs
            SET last_write = :write_id, {counter.name} = jobs.{counter.name} + :count,
                progress = coalesce(:progress, jobs.progress)
            FROM held WHERE jobs.id = held.id AND held.last_write IS DISTINCT FROM :write_id
            RETURNING jobs.{counter.name} - :count AS last_before
        ), written AS ({_INSERT})
        SELECT id FROM held
    """)  # noqa: S608 # Names of columns.
    for channel, counter in _NUM.items()
}
# Entries may be long: of those that a reader asks for, it gets as many as have these bytes, and one more.
_BYTES_BEFORE = """
    sum(octet_length(data)) OVER (ORDER BY number ROWS UNBOUNDED PRECEDING) - octet_length(data)
    AS bytes_before
"""
_READ = text(f"""
    SELECT jobs.status,
        (SELECT json_agg(found ORDER BY found.first) FROM (
            SELECT channel, first, last, key, size, sha256 FROM chunks
            WHERE job_id = :job_id AND channel = :channel AND last > :after ORDER BY first LIMIT :chunks
        ) AS found) AS chunks, behind.*
    FROM jobs CROSS JOIN LATERAL (
        SELECT count(*) AS num, json_agg(json_build_array(number, kind, time, data) ORDER BY number)
            FILTER (WHERE bytes_before < :bytes) AS entries
        FROM (
            SELECT number, kind, time, data, {_BYTES_BEFORE} FROM entries
            WHERE job_id = :job_id AND channel = :channel AND number > :after ORDER BY number LIMIT :limit
        ) AS found
    ) AS behind
    WHERE jobs.id = :job_id
""")  # noqa: S608 # A constant.
_OLDEST = text(f"""
    SELECT number, kind, time, data FROM (
        SELECT number, kind, time, data, {_BYTES_BEFORE} FROM entries
        WHERE job_id = :job_id AND channel = :channel ORDER BY number LIMIT :limit
    ) AS found WHERE bytes_before < :bytes ORDER BY number
""")  # noqa: S608 # A constant.
# JSON made by PostgreSQL for each entry would take most of the time. Entries count only after the last chunk.
_READ_METRICS = text(f"""
    WITH known AS (
        SELECT channel, first, last, key, size, sha256 FROM chunks
        WHERE job_id = :job_id AND channel = 'events' AND last > :after ORDER BY first LIMIT :chunks
    )
    SELECT (SELECT json_agg(known ORDER BY known.first) FROM known) AS chunks, behind.*
    FROM jobs CROSS JOIN LATERAL (
        SELECT count(*) FILTER (WHERE bytes_before < :bytes) AS num, count(*) AS num_before_bytes,
            max(number) FILTER (WHERE bytes_before < :bytes) AS last,
            array_agg(date_part('epoch', time) ORDER BY number)
                FILTER (WHERE kind = 'metrics' AND bytes_before < :bytes) AS times,
            string_agg(data, ',' ORDER BY number)
                FILTER (WHERE kind = 'metrics' AND bytes_before < :bytes) AS data
        FROM (
            SELECT number, kind, time, data, {_BYTES_BEFORE} FROM entries
            WHERE job_id = :job_id AND channel = 'events' AND number > :after ORDER BY number
            LIMIT CASE WHEN (SELECT count(*) FROM known) < :chunks THEN :limit ELSE 0 END
        ) AS found
    ) AS behind
    WHERE jobs.id = :job_id
""")  # noqa: S608 # A constant.
# A reader gets a few chunks at a time; each is a request to the object store.
_MAX_CHUNKS = 4
_PART_BYTES = 2**20
_AT_ONCE = {"chunks": _MAX_CHUNKS + 1, "bytes": _PART_BYTES}
_MAX_DUE = 200
# Appending one batch takes a fraction of a call's time limit.
_BATCH = 1000
_BATCH_BYTES = 2**20


class Feeds(Session):
    """The part of a JobStore that has the jobs' feeds."""

    def record(
        self,
        job_id: str,
        token: str,
        channel: Channel,
        entries: Sequence[Entry],
        progress: Progress | None = None,
        *,
        write_id: str,
    ) -> None:
        values = {
            "job_id": job_id,
            "token": token,
            "channel": channel,
            "write_id": write_id,
            **_said(entries, progress),
        }
        with self._statements() as connection:
            if connection.execute(_APPEND_AS_ATTEMPT[channel], values).first() is None:
                raise LeaseLost(job_id)

    def feed(self, job_id: str, channel: Channel, *, after: int = 0, limit: int = 1000) -> FeedPart:
        asked = {"job_id": job_id, "channel": channel, "after": after, "limit": limit, **_AT_ONCE}
        with self._statements() as connection:
            found = connection.execute(_READ, asked).first()
        if found is None:
            raise JobNotFound(job_id[:64])
        parts = [Chunk(**chunk) for chunk in found.chunks or ()]
        if len(parts) > _MAX_CHUNKS:
            return FeedPart(parts[:_MAX_CHUNKS], (), rows.status(found.status), is_end=False)
        behind = [_entry_of(*entry) for entry in found.entries or ()]
        is_end = found.num == len(behind) < limit
        return FeedPart(parts, behind, rows.status(found.status), is_end=is_end)

    def feed_metrics(self, job_id: str, *, after: int, limit: int) -> MeasuredPart:
        asked = {"job_id": job_id, "after": after, "limit": limit, **_AT_ONCE}
        with self._statements() as connection:
            found = connection.execute(_READ_METRICS, asked).first()
        if found is None:
            raise JobNotFound(job_id[:64])
        parts = [Chunk(**chunk) for chunk in found.chunks or ()]
        if len(parts) > _MAX_CHUNKS:
            return MeasuredPart(parts[:_MAX_CHUNKS], (), last=0, is_end=False)
        behind = in_rows(found.times, f"[{found.data}]") if found.data else ()
        is_end = found.num == found.num_before_bytes < limit
        return MeasuredPart(parts, behind, last=found.last or 0, is_end=is_end)

    def long_feeds(self, *, max_bytes: int, max_age: timedelta) -> Sequence[tuple[str, Channel]]:
        size = func.sum(func.octet_length(entries.c.data))
        is_old = func.min(entries.c.stored_at) < NOW - max_age
        has_ended = func.bool_and(jobs.c.status.notin_(UNFINISHED))
        due = (
            select(entries.c.job_id, entries.c.channel)
            .join(jobs, jobs.c.id == entries.c.job_id)
            .group_by(entries.c.job_id, entries.c.channel)
            .having(or_(size >= max_bytes, is_old, has_ended))
            .order_by(entries.c.job_id)
            .limit(_MAX_DUE)
        )
        with self._transaction() as connection:
            return [(row.job_id, row.channel) for row in connection.execute(due)]

    def oldest_entries(
        self, job_id: str, channel: Channel, *, limit: int, max_bytes: int = 2**40
    ) -> Sequence[Entry]:
        asked = {"job_id": job_id, "channel": channel, "limit": limit, "bytes": max_bytes}
        with self._statements() as connection:
            return [_entry_of(*row) for row in connection.execute(_OLDEST, asked)]

    def replace_by_chunk(self, job_id: str, chunk: Chunk) -> None:
        name = insert(chunks).values(job_id=job_id, **asdict(chunk)).on_conflict_do_nothing()
        held = delete(entries).where(
            entries.c.job_id == job_id,
            entries.c.channel == chunk.channel,
            entries.c.number.between(chunk.first, chunk.last),
        )
        with self._transaction() as connection:  # So that a reader finds each entry in one place.
            if not rows.hold_job(connection, job_id):
                return
            if connection.execute(name.returning(chunks.c.first)).first() is not None:
                connection.execute(held)

    def chunks(self, job_ids: Collection[str]) -> Mapping[str, Sequence[Chunk]]:
        found: dict[str, list[Chunk]] = defaultdict(list)
        wanted = select(chunks).where(chunks.c.job_id.in_(job_ids)).order_by(chunks.c.channel, chunks.c.first)
        with self._statements() as connection:
            for row in connection.execute(wanted):
                chunk = Chunk(row.channel, row.first, row.last, row.key, row.size, row.sha256)
                found[row.job_id].append(chunk)
        return found

    def replace_chunk(self, job_id: str, lost: Chunk, found: Chunk) -> None:
        known = update(chunks).where(
            chunks.c.job_id == job_id, chunks.c.channel == lost.channel, chunks.c.key == lost.key
        )
        with self._transaction() as connection:
            connection.execute(known.values(key=found.key, size=found.size, sha256=found.sha256))


def append(
    connection: Connection,
    job_id: str,
    channel: Channel,
    said: Sequence[Entry],
    progress: Progress | None = None,
) -> None:
    """Number the entries and store them, with the progress if given."""
    values = {"job_id": job_id, "channel": channel, **_said(said, progress)}
    connection.execute(_APPEND[channel], values)


@contextmanager
def prepared(said: Iterable[Entry]) -> Generator[Iterator[_Batch]]:
    """Any number of entries, read now, and ready to be appended in batches: a file holds them, so that the
    transaction waits for nobody. Raises StorageUnavailable where this machine has no room for it."""
    with TemporaryFile(prefix="gaitway-feed-") as file:
        try:
            for batch in _batches(said):
                file.write(to_json(batch) + b"\n")
            file.seek(0)
        except OSError as error:
            raise StorageUnavailable(f"The API has no room for the feed: {error.strerror}.") from error
        yield map(from_json, file)


def _batches(said: Iterable[Entry]) -> Iterator[_Batch]:
    """Kinds, times and data of entries, as many as one statement stores."""
    kinds, times, data, size = list[str](), list[str](), list[str](), 0
    for entry in said:
        text = _text(entry)
        if kinds and (len(kinds) == _BATCH or size + len(text) > _BATCH_BYTES):
            yield kinds, times, data
            kinds, times, data, size = [], [], [], 0
        kinds.append(entry.kind)
        times.append(entry.time.isoformat())
        data.append(text)
        size += len(text)
    if kinds:
        yield kinds, times, data


def append_all(connection: Connection, job_id: str, channel: Channel, batches: Iterable[_Batch]) -> None:
    """Append what `prepared` has made ready."""
    for kinds, times, data in batches:
        said = {"count": len(kinds), "kinds": kinds, "times": times, "data": data}
        connection.execute(_APPEND[channel], {"job_id": job_id, "channel": channel, "progress": None, **said})


def _said(said: Sequence[Entry], progress: Progress | None) -> dict[str, Any]:
    return {
        "progress": None if progress is None else progress.model_dump_json(),
        "count": len(said),
        "kinds": [entry.kind for entry in said],
        "times": [entry.time for entry in said],
        "data": [_text(entry) for entry in said],
    }


def _text(entry: Entry) -> str:
    return to_json(entry.data, inf_nan_mode="null").decode()


def _entry_of(number: int, kind: str, time: Any, data: str) -> Entry:
    """time: a datetime, or text in ISO 8601."""
    return Entry(id=str(number), kind=kind, time=time, data=json.loads(data))
