"""A job's feeds: numbered entries, and metrics in blocks; older ones lie in chunks in the object store."""

import json
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime, timedelta
from typing import Any

from pydantic_core import to_json
from sqlalchemy import (
    Column,
    Connection,
    Row,
    TextClause,
    delete,
    func,
    literal,
    or_,
    select,
    text,
    union_all,
    update,
)
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres import rows
from core.adapters.postgres.engine import Session
from core.adapters.postgres.tables import NOW, UNFINISHED, chunks, entries, jobs, metrics
from core.errors import JobNotFound, LeaseLost
from core.jobs.job import Progress
from core.jobs.metrics import Block
from core.jobs.store import (
    Channel,
    Chunk,
    Entry,
    FeedPart,
    MetricsPart,
    metrics_entries,
    metrics_row,
)

_NUM: dict[Channel, Column[int]] = {"events": jobs.c.num_events, "logs": jobs.c.num_logs}
_WRITTEN = """
    written AS (
        INSERT INTO entries (job_id, channel, number, kind, time, data)
        SELECT :job_id, :channel, last_before + entry.place, entry.kind, entry.time, entry.data
        FROM grown, unnest(CAST(:places AS bigint[]), CAST(:kinds AS text[]), CAST(:times AS timestamptz[]),
            CAST(:data AS text[])) AS entry (place, kind, time, data)
    ), measured AS (
        INSERT INTO metrics (job_id, first, last, block)
        SELECT :job_id, last_before + :first, last_before + :last, metrics.block
        FROM grown, CAST(:block AS bytea) AS metrics (block) WHERE metrics.block IS NOT NULL
    )
"""
# Writing to a feed and reading it are one statement each: most of the time went into round trips.
_APPEND: dict[Channel, TextClause] = {
    channel: text(f"""
        WITH grown AS (
            UPDATE jobs
            SET {counter.name} = {counter.name} + :count, progress = coalesce(:progress, progress)
            WHERE id = :job_id
            RETURNING {counter.name} - :count AS last_before
        ), {_WRITTEN}
        SELECT last_before FROM grown
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
        ), {_WRITTEN}
        SELECT id FROM held
    """)  # noqa: S608 # Names of columns.
    for channel, counter in _NUM.items()
}


def _bytes_before(column: str, order: str) -> str:
    """Entries may be long: of those that a reader asks for, it gets as many as have these bytes, and one
    more."""
    size = f"octet_length({column})"
    return f"sum({size}) OVER (ORDER BY {order} ROWS UNBOUNDED PRECEDING) - {size} AS bytes_before"


_READ = text(f"""
    SELECT jobs.status, jobs.num_events, jobs.num_logs,
        (SELECT json_agg(found ORDER BY found.first) FROM (
            SELECT channel, first, last, key, size, sha256 FROM chunks
            WHERE job_id = :job_id AND channel = ANY(CAST(:channels AS text[])) AND last > :after
            ORDER BY first LIMIT :chunks
        ) AS found) AS chunks, behind.*, measured.*
    FROM jobs CROSS JOIN LATERAL (
        SELECT count(*) AS num_entries, json_agg(json_build_array(number, kind, time, data) ORDER BY number)
            FILTER (WHERE bytes_before < :bytes) AS entries
        FROM (
            SELECT number, kind, time, data, {_bytes_before("data", "number")} FROM entries
            WHERE job_id = :job_id AND channel = :channel AND number > :after ORDER BY number LIMIT :limit
        ) AS found
    ) AS behind CROSS JOIN LATERAL (
        SELECT count(*) AS num_blocks, max(last) FILTER (WHERE bytes_before < :block_bytes) AS last_measured,
            array_agg(first ORDER BY first) FILTER (WHERE bytes_before < :block_bytes) AS firsts,
            array_agg(block ORDER BY first) FILTER (WHERE bytes_before < :block_bytes) AS blocks
        FROM (
            SELECT first, last, block, {_bytes_before("block", "first")} FROM metrics
            WHERE job_id = :job_id AND 'metrics' = ANY(CAST(:channels AS text[])) AND last > :after
            ORDER BY first LIMIT :limit
        ) AS found
    ) AS measured
    WHERE jobs.id = :job_id
""")  # noqa: S608 # Constants.
_OLDEST = text(f"""
    SELECT number, kind, time, data FROM (
        SELECT number, kind, time, data, {_bytes_before("data", "number")} FROM entries
        WHERE job_id = :job_id AND channel = :channel ORDER BY number LIMIT :limit
    ) AS found WHERE bytes_before < :bytes ORDER BY number
""")  # noqa: S608 # A constant.
_OLDEST_METRICS = text(f"""
    SELECT first, block FROM (
        SELECT first, block, {_bytes_before("block", "first")} FROM metrics WHERE job_id = :job_id
    ) AS found WHERE bytes_before < :bytes ORDER BY first
""")  # noqa: S608 # A constant.
# A reader gets a few chunks at a time; each is a request to the object store.
_MAX_CHUNKS = 4
_AT_ONCE = {"chunks": _MAX_CHUNKS + 1, "bytes": 2**20}
# The bytes of blocks in one read: for a stream, which makes an entry of each row; for metrics alone.
_STREAM_BYTES, _BLOCK_BYTES = 2**17, 2**20
_MAX_BLOCKS = 2000
_MAX_DUE = 200


def _values_of(added: Sequence[Entry]) -> dict[str, Any]:
    """The parameters of `_WRITTEN`, but for the job and the channel."""
    places, kinds, times, data = list[int](), list[str](), list[str](), list[str]()
    measured = Block()
    for place, entry in enumerate(added, 1):
        if entry.kind == "metrics":
            measured.add(metrics_row(entry, place))
            continue
        places.append(place)
        kinds.append(entry.kind)
        times.append(entry.time.isoformat())
        data.append(to_json(entry.data, inf_nan_mode="null").decode())
    block = measured.encode() if measured.tables else None
    texts = {"places": places, "kinds": kinds, "times": times, "data": data}
    return {"count": len(added), **texts, "first": measured.first, "last": measured.last, "block": block}


class _Found:
    """A row of `_READ`, and how far it reaches: up to entry number `last`, the feed's end if `is_end`."""

    def __init__(self, row: Row[Any], end: int, limit: int) -> None:
        found = [Chunk(**chunk) for chunk in row.chunks or ()]
        self.status = rows.status(row.status)
        self.chunks = found[:_MAX_CHUNKS]
        self.entries: list[Any] = row.entries or []
        self.blocks = list(zip(row.firsts or (), row.blocks or (), strict=True))
        cuts = [chunk.first - 1 for chunk in found[_MAX_CHUNKS:]]
        if row.num_entries == limit or row.num_entries > len(self.entries):
            cuts.append(self.entries[-1][0])
        if row.num_blocks == limit or row.num_blocks > len(self.blocks):
            cuts.append(row.last_measured)
        self.last = min(cuts, default=end)
        self.is_end = not cuts


class FeedQueries(Session):
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
            "progress": None if progress is None else progress.model_dump_json(),
            **_values_of(entries),
        }
        with self._statements() as connection:
            if connection.execute(_APPEND_AS_ATTEMPT[channel], values).first() is None:
                raise LeaseLost(job_id)

    def feed(self, job_id: str, channel: Channel, *, after: int = 0, limit: int = 1000) -> FeedPart:
        channels: list[Channel] = [channel, "metrics"] if channel == "events" else [channel]
        found = self._read(job_id, channels, after, limit, _STREAM_BYTES)
        part = [_entry_of(*entry) for entry in found.entries]
        for first, block in found.blocks:
            part += metrics_entries(Block.decode(block, first).after(after))
        part = sorted((entry for entry in part if int(entry.id) <= found.last), key=lambda one: int(one.id))
        last, is_end = found.last, found.is_end
        if len(part) > limit:
            part, last, is_end = part[:limit], int(part[limit - 1].id), False
        return FeedPart(found.chunks, part, found.status, last, is_end)

    def feed_metrics(self, job_id: str, *, after: int = 0) -> MetricsPart:
        found = self._read(job_id, ["metrics"], after, _MAX_BLOCKS, _BLOCK_BYTES)
        blocks = [(first, block) for first, block in found.blocks if first <= found.last]
        return MetricsPart(found.chunks, blocks, found.last, found.is_end)

    def _read(self, job_id: str, channels: list[Channel], after: int, limit: int, block_bytes: int) -> _Found:
        asked = {"job_id": job_id, "channel": channels[0], "channels": channels, "after": after}
        asked |= {"limit": limit, "block_bytes": block_bytes, **_AT_ONCE}
        with self._statements() as connection:
            row = connection.execute(_READ, asked).first()
        if row is None:
            raise JobNotFound(job_id[:64])
        return _Found(row, max(after, row.num_logs if channels == ["logs"] else row.num_events), limit)

    def long_feeds(
        self, *, max_bytes: int, max_age: timedelta, max_metrics_bytes: int
    ) -> Sequence[tuple[str, Channel]]:
        size = func.sum(func.octet_length(entries.c.data))
        is_old = func.min(entries.c.stored_at) < NOW - max_age
        has_ended = func.bool_and(jobs.c.status.notin_(UNFINISHED))
        events_and_logs = (
            select(entries.c.job_id, entries.c.channel)
            .join(jobs, jobs.c.id == entries.c.job_id)
            .group_by(entries.c.job_id, entries.c.channel)
            .having(or_(size >= max_bytes, is_old, has_ended))
        )
        measured = (
            select(metrics.c.job_id, literal("metrics").label("channel"))
            .join(jobs, jobs.c.id == metrics.c.job_id)
            .group_by(metrics.c.job_id)
            .having(or_(func.sum(func.octet_length(metrics.c.block)) >= max_metrics_bytes, has_ended))
        )
        due = union_all(events_and_logs, measured).order_by("job_id").limit(_MAX_DUE)
        with self._transaction() as connection:
            return [(row.job_id, row.channel) for row in connection.execute(due)]

    def oldest_entries(
        self, job_id: str, channel: Channel, *, limit: int, max_bytes: int = 2**40
    ) -> Sequence[Entry]:
        asked = {"job_id": job_id, "channel": channel, "limit": limit, "bytes": max_bytes}
        with self._statements() as connection:
            return [_entry_of(*row) for row in connection.execute(_OLDEST, asked)]

    def oldest_metrics(self, job_id: str, *, max_bytes: int = 2**40) -> Sequence[tuple[int, bytes]]:
        with self._statements() as connection:
            found = connection.execute(_OLDEST_METRICS, {"job_id": job_id, "bytes": max_bytes})
            return [(row.first, row.block) for row in found]

    def replace_by_chunk(self, job_id: str, chunk: Chunk) -> None:
        name = insert(chunks).values(job_id=job_id, **asdict(chunk)).on_conflict_do_nothing()
        if chunk.channel == "metrics":
            held = delete(metrics).where(metrics.c.first.between(chunk.first, chunk.last))
            held = held.where(metrics.c.job_id == job_id)
        else:
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


def append(connection: Connection, job_id: str, channel: Channel, added: Sequence[Entry]) -> None:
    """Number the entries and store them."""
    values = {"job_id": job_id, "channel": channel, "progress": None, **_values_of(added)}
    connection.execute(_APPEND[channel], values)


def add_chunks(connection: Connection, job_id: str, added: Sequence[Chunk]) -> None:
    """Give a job whose feeds are empty these chunks, which begin them."""
    if not added:
        return
    connection.execute(insert(chunks), [{"job_id": job_id, **asdict(chunk)} for chunk in added])
    num_logs = max((chunk.last for chunk in added if chunk.channel == "logs"), default=0)
    num_events = max((chunk.last for chunk in added if chunk.channel != "logs"), default=0)
    grown = update(jobs).where(jobs.c.id == job_id).values(num_events=num_events, num_logs=num_logs)
    connection.execute(grown)


def _entry_of(number: int, kind: str, time: datetime | str, data: str) -> Entry:
    """time: text is in ISO 8601."""
    when = datetime.fromisoformat(time) if isinstance(time, str) else time
    return Entry(kind, when, json.loads(data), str(number))
