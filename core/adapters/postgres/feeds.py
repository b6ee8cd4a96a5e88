"""A job's feeds: numbered entries, whose older part lies in chunks in the object store."""

import json
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from datetime import timedelta
from typing import Any

from pydantic_core import to_json
from sqlalchemy import Connection, Row, delete, func, or_, select, update
from sqlalchemy.dialects.postgresql import insert

from core.adapters.postgres.tables import NOW, UNFINISHED, chunks, entries, jobs
from core.jobs.job import Progress
from core.jobs.store import Channel, Chunk, Entry, FeedPart

_NUM = {"events": jobs.c.num_events, "logs": jobs.c.num_logs}
# A reader gets a few at a time; each is a request to the object store.
_MOST_CHUNKS = 4
_MOST_DUE = 200


def append_as_attempt(  # noqa: PLR0913 # As in the seam.
    connection: Connection,
    job_id: str,
    token: str,
    channel: Channel,
    said: Sequence[Entry],
    progress: Progress | None,
    write_id: str,
) -> bool:
    """Append in the name of the attempt that holds the job; whether it does."""
    held = connection.execute(
        select(jobs.c.last_write)
        .where(jobs.c.id == job_id, jobs.c.token == token, jobs.c.token != "")
        .with_for_update()
    ).first()
    if held is None:
        return False
    if held.last_write != write_id:
        values: dict[str, Any] = {"last_write": write_id}
        if progress is not None:
            values["progress"] = progress.model_dump_json()
        append(connection, job_id, channel, said, values)
    return True


def append(
    connection: Connection,
    job_id: str,
    channel: Channel,
    said: Sequence[Entry],
    values: dict[str, Any] | None = None,
) -> None:
    """Number the entries and store them; `values` go into the job's row."""
    counter = _NUM[channel]
    last = connection.execute(
        update(jobs)
        .where(jobs.c.id == job_id)
        .values({**(values or {}), counter.name: counter + len(said)})
        .returning(counter)
    ).scalar_one()
    if said:
        first = last - len(said) + 1
        connection.execute(
            insert(entries),
            [
                {
                    "job_id": job_id,
                    "channel": channel,
                    "number": number,
                    "kind": entry.kind,
                    "time": entry.time,
                    "data": to_json(entry.data, inf_nan_mode="null").decode(),
                }
                for number, entry in enumerate(said, first)
            ],
        )


def read(connection: Connection, job_id: str, channel: Channel, after: int, limit: int) -> FeedPart:
    """The chunks that reach beyond `after`; and, where these are all, the entries behind them."""
    found = connection.execute(
        select(chunks)
        .where(chunks.c.job_id == job_id, chunks.c.channel == channel, chunks.c.last > after)
        .order_by(chunks.c.first)
        .limit(_MOST_CHUNKS + 1)
    ).all()
    parts = [_chunk_of(row) for row in found[:_MOST_CHUNKS]]
    if len(found) > _MOST_CHUNKS:
        return FeedPart(parts, ())
    return FeedPart(parts, entries_after(connection, job_id, channel, after, limit))


def entries_after(
    connection: Connection, job_id: str, channel: Channel, after: int, limit: int
) -> Sequence[Entry]:
    """Entries that lie in no chunk, oldest first."""
    rows = connection.execute(
        select(entries)
        .where(entries.c.job_id == job_id, entries.c.channel == channel, entries.c.number > after)
        .order_by(entries.c.number)
        .limit(limit)
    )
    return [
        Entry(id=str(row.number), kind=row.kind, time=row.time, data=json.loads(row.data)) for row in rows
    ]


def due(connection: Connection, max_bytes: int, max_age: timedelta) -> Sequence[tuple[str, Channel]]:
    """Feeds with entries that should lie in a chunk by now."""
    size = func.sum(func.octet_length(entries.c.data))
    is_old = func.min(entries.c.time) < NOW - max_age
    has_ended = func.bool_and(jobs.c.status.notin_(UNFINISHED))
    found = connection.execute(
        select(entries.c.job_id, entries.c.channel)
        .join(jobs, jobs.c.id == entries.c.job_id)
        .group_by(entries.c.job_id, entries.c.channel)
        .having(or_(size >= max_bytes, is_old, has_ended))
        .order_by(entries.c.job_id)
        .limit(_MOST_DUE)
    )
    return [(row.job_id, row.channel) for row in found]


def chunks_of(connection: Connection, job_ids: Collection[str]) -> Mapping[str, Sequence[Chunk]]:
    found: dict[str, list[Chunk]] = defaultdict(list)
    wanted = select(chunks).where(chunks.c.job_id.in_(job_ids)).order_by(chunks.c.channel, chunks.c.first)
    for row in connection.execute(wanted):
        found[row.job_id].append(_chunk_of(row))
    return found


def adopt(connection: Connection, job_id: str, found: Sequence[Chunk]) -> None:
    """Name chunks that were made earlier; what is appended from now on is numbered behind them."""
    for chunk in found:
        replace_by_chunk(connection, job_id, chunk)
        counter = _NUM[chunk.channel]
        highest = func.greatest(counter, chunk.last)
        connection.execute(update(jobs).where(jobs.c.id == job_id).values({counter.name: highest}))


def replace_chunk(connection: Connection, job_id: str, lost: Chunk, found: Chunk) -> None:
    connection.execute(
        update(chunks)
        .where(chunks.c.job_id == job_id, chunks.c.channel == lost.channel, chunks.c.key == lost.key)
        .values(key=found.key, size=found.size, sha256=found.sha256)
    )


def _chunk_of(row: Row[Any]) -> Chunk:
    return Chunk(row.channel, row.first, row.last, row.key, row.size, row.sha256)


def replace_by_chunk(connection: Connection, job_id: str, chunk: Chunk) -> None:
    """In one transaction, so that a reader finds each entry in one place."""
    if not _is_there(connection, job_id):
        return
    named = connection.execute(
        insert(chunks)
        .values(
            job_id=job_id,
            channel=chunk.channel,
            first=chunk.first,
            last=chunk.last,
            key=chunk.key,
            size=chunk.size,
            sha256=chunk.sha256,
        )
        .on_conflict_do_nothing()
        .returning(chunks.c.first)
    ).first()
    if named is not None:
        connection.execute(
            delete(entries).where(
                entries.c.job_id == job_id,
                entries.c.channel == chunk.channel,
                entries.c.number.between(chunk.first, chunk.last),
            )
        )


def _is_there(connection: Connection, job_id: str) -> bool:
    """Whether the job is there, and stays until the end of the transaction."""
    wanted = select(jobs.c.id).where(jobs.c.id == job_id).with_for_update(read=True, key_share=True)
    return connection.execute(wanted).first() is not None
