"""Job records in Redis or Valkey.

gaitway:job:<id>          hash: the record (core/adapters/redis_scripts.py)
gaitway:job:<id>:events   stream, as is :logs; the stream's ids are the entries' ids
gaitway:lease:<id>        the token of the attempt that holds the job; expires with its lease
gaitway:jobs              sorted set of every id, all of one score: in the order of the ids, that is of time
gaitway:unfinished        the same for those without a final status
gaitway:idempotency:<h>   hash: fingerprint, job; expires after a day
gaitway:worker:<name>     what a worker says of itself; expires; gaitway:workers is the set of names
"""

import hashlib
import secrets
import time
from collections.abc import Iterable, Iterator, Sequence
from datetime import timedelta
from typing import Any

from redis import Redis

from core.adapters import redis_scripts as scripts
from core.adapters.cursors import check_cursor, entry_position
from core.adapters.entries import status_entry
from core.adapters.redis_errors import reaching_redis
from core.errors import IdempotencyKeyReused, JobExists, JobNotFound, LeaseLost, StaleJob
from core.jobs.job import Job, Progress, check_job_id
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry, Idempotency, JobQuery, Page, WorkerInfo

LONGEST_BLOCK_S = 5.0
REMEMBERED = timedelta(hours=24)
FEED_LENGTH = 100_000

_JOB, _INDEX, _UNFINISHED = "gaitway:job:", "gaitway:jobs", "gaitway:unfinished"
_WORKER, _WORKERS = "gaitway:worker:", "gaitway:workers"
_BATCH = 200


class RedisJobStore:
    """A JobStore for many processes; thread-safe."""

    def __init__(self, client: "Redis") -> None:
        self._redis: Any = client
        self._add = self._redis.register_script(scripts.ADD)
        self._save = self._redis.register_script(scripts.SAVE)
        self._delete = self._redis.register_script(scripts.DELETE)
        self._renew = self._redis.register_script(scripts.RENEW)
        self._record = self._redis.register_script(scripts.RECORD)

    @reaching_redis()
    def add(self, job: Job, idempotency: Idempotency | None = None) -> Job:
        # The script takes "" for no key at all; a fingerprint may be anything.
        key, fingerprint = ("", "") if idempotency is None else (idempotency.key, _mark(idempotency))
        word, job_id = self._add(
            keys=[_job(job.id), _INDEX, _UNFINISHED, _idempotency(key)],
            args=[
                *(job.id, job.version, _document(job), job.status, job.token),
                *(job.progress.model_dump_json(), _nonce(), int(job.status.is_final)),
                *(_JOB, fingerprint, _milliseconds(REMEMBERED)),
            ],
        )
        match word:
            case b"reused":
                raise IdempotencyKeyReused(key)
            case b"exists":
                raise JobExists(job.id)
            case _:
                return job if job_id.decode() == job.id else self.get(job_id.decode())

    @reaching_redis()
    def remembered(self, idempotency: Idempotency) -> Job | None:
        seen = self._redis.hmget(_idempotency(idempotency.key), "fingerprint", "job")
        if seen[1] is None or not self._redis.exists(_job(seen[1].decode())):
            return None
        if seen[0].decode() != _mark(idempotency):
            raise IdempotencyKeyReused(idempotency.key)
        return self.get(seen[1].decode())

    @reaching_redis()
    def get(self, job_id: str) -> Job:
        document, progress = self._redis.hmget(_job(job_id), "document", "progress")
        if document is None:
            raise JobNotFound(job_id)
        return _read(document, progress)

    @reaching_redis()
    def save(self, job: Job, *, lease: timedelta | None = None) -> None:
        entry = status_entry(job)
        word = self._save(
            keys=[_job(job.id), _feed(job.id, "events"), _lease(job.id), _UNFINISHED],
            args=[
                *(job.id, job.version, _document(job), job.status, job.token, _nonce()),
                *(int(job.status.is_final), 0 if lease is None else _milliseconds(lease)),
                *(entry.kind, entry.model_dump_json(exclude={"id"}), FEED_LENGTH),
            ],
        )
        _check(word, job.id)

    @reaching_redis()
    def delete(self, job: Job) -> None:
        feeds = [_feed(job.id, "events"), _feed(job.id, "logs")]
        word = self._delete(
            keys=[_job(job.id), *feeds, _lease(job.id), _INDEX, _UNFINISHED], args=[job.id, job.version]
        )
        _check(word, job.id)

    @reaching_redis()
    def list(self, query: JobQuery, *, cursor: str | None = None, limit: int = 50) -> Page:
        before = None if cursor is None else check_cursor(cursor)
        found: list[Job] = []
        for job in self._newest_first(before):
            if query.matches(job):
                # One more than asked for has been found: there is a next page.
                if len(found) == limit:
                    return Page(found, found[-1].id)
                found.append(job)
        return Page(found, None)

    @reaching_redis()
    def unfinished(self) -> Iterable[Job]:
        ids = self._redis.zrange(_UNFINISHED, 0, -1)
        batches = (self._get_many(ids[i : i + _BATCH]) for i in range(0, len(ids), _BATCH))
        return [job for batch in batches for job in batch if not job.status.is_final]

    @reaching_redis()
    def renew(self, job_id: str, token: str, lease: timedelta) -> JobStatus:
        status = self._renew(keys=[_job(job_id), _lease(job_id)], args=[token, _milliseconds(lease)])
        if not status:
            raise LeaseLost(job_id)
        return JobStatus(status.decode())

    @reaching_redis()
    def lease_is_alive(self, job_id: str) -> bool:
        return bool(self._redis.exists(_lease(job_id)))

    @reaching_redis()
    def record(
        self,
        job_id: str,
        token: str,
        channel: Channel,
        entries: Sequence[Entry],
        progress: Progress | None = None,
    ) -> None:
        said = [part for entry in entries for part in (entry.kind, entry.model_dump_json(exclude={"id"}))]
        word = self._record(
            keys=[_job(job_id), _feed(job_id, channel)],
            args=[token, _nonce(), progress.model_dump_json() if progress else "", FEED_LENGTH, *said],
        )
        if word == b"lost":
            raise LeaseLost(job_id)

    @reaching_redis()
    def feed(
        self, job_id: str, channel: Channel, *, after: str = "", kind: str | None = None, limit: int = 1000
    ) -> Sequence[Entry]:
        found: list[Entry] = []
        position = entry_position(after)
        if not self._redis.exists(_job(job_id)):
            raise JobNotFound(job_id)
        while len(found) < limit:
            # Everything of one kind may lie far apart: read on in pieces until there is enough of it.
            wanted = limit - len(found) if kind is None else max(limit, _BATCH)
            start = f"({position[0]}-{position[1]}"
            piece = self._redis.xrange(_feed(job_id, channel), min=start, max="+", count=wanted)
            found += [_entry(at, said) for at, said in piece if kind in (None, said[b"kind"].decode())]
            if len(piece) < wanted:
                break
            position = entry_position(piece[-1][0].decode())
        return found[:limit]

    @reaching_redis()
    def wait(self, job_id: str, channel: Channel, *, after: str = "", timeout: timedelta) -> bool:
        position = "{}-{}".format(*entry_position(after))
        deadline = time.monotonic() + timeout.total_seconds()
        while True:
            # A block of 0 ms would be for ever, and one longer than the socket's timeout an error.
            left_s = min(deadline - time.monotonic(), LONGEST_BLOCK_S)
            block = max(1, int(left_s * 1000))
            if self._redis.xread({_feed(job_id, channel): position}, count=1, block=block):
                return True
            if time.monotonic() >= deadline:
                return False

    @reaching_redis()
    def announce(self, worker: WorkerInfo, ttl: timedelta) -> None:
        with self._redis.pipeline() as pipeline:
            pipeline.set(_WORKER + worker.name, worker.model_dump_json(), px=ttl)
            pipeline.sadd(_WORKERS, worker.name)
            pipeline.execute()

    @reaching_redis()
    def withdraw(self, name: str) -> None:
        with self._redis.pipeline() as pipeline:
            pipeline.delete(_WORKER + name)
            pipeline.srem(_WORKERS, name)
            pipeline.execute()

    @reaching_redis()
    def workers(self) -> Sequence[WorkerInfo]:
        names: list[bytes] = sorted(self._redis.smembers(_WORKERS))
        if not names:
            return []
        said: list[bytes | None] = self._redis.mget([_WORKER.encode() + name for name in names])
        if gone := [name for name, info in zip(names, said, strict=True) if info is None]:
            self._redis.srem(_WORKERS, *gone)
        return [WorkerInfo.model_validate_json(info) for info in said if info is not None]

    @reaching_redis()
    def ping(self) -> None:
        self._redis.ping()

    def _newest_first(self, before: str | None) -> Iterator[Job]:
        while True:
            top = "+" if before is None else f"({before}"
            ids = self._redis.zrange(_INDEX, top, "-", bylex=True, desc=True, offset=0, num=_BATCH)
            yield from self._get_many(ids)
            if len(ids) < _BATCH:
                return
            before = ids[-1].decode()

    def _get_many(self, ids: Sequence[bytes]) -> Iterator[Job]:
        with self._redis.pipeline(transaction=False) as pipeline:
            for job_id in ids:
                pipeline.hmget(_job(job_id.decode()), "document", "progress")
            for document, progress in pipeline.execute():
                if document is not None:  # it may have been deleted meanwhile
                    yield _read(document, progress)


def _job(job_id: str) -> str:
    return _JOB + check_job_id(job_id)


def _feed(job_id: str, channel: Channel) -> str:
    return f"{_job(job_id)}:{channel}"


def _lease(job_id: str) -> str:
    return f"gaitway:lease:{check_job_id(job_id)}"


def _idempotency(key: str) -> str:
    return f"gaitway:idempotency:{hashlib.sha256(key.encode('utf-8', 'surrogatepass')).hexdigest()}"


def _mark(idempotency: Idempotency) -> str:
    return f"={idempotency.fingerprint}"


def _nonce() -> str:
    return secrets.token_hex(8)


def _milliseconds(span: timedelta) -> int:
    return max(1, round(span.total_seconds() * 1000))


def _document(job: Job) -> str:
    return job.model_dump_json(exclude={"progress"})


def _read(document: bytes, progress: bytes | None) -> Job:
    job = Job.model_validate_json(document)
    return job.model_copy(update={"progress": Progress.model_validate_json(progress)}) if progress else job


def _entry(entry_id: bytes, said: dict[bytes, bytes]) -> Entry:
    return Entry.model_validate_json(said[b"entry"]).model_copy(update={"id": entry_id.decode()})


def _check(word: bytes, job_id: str) -> None:
    if word == b"missing":
        raise JobNotFound(job_id)
    if word == b"stale":
        raise StaleJob(job_id)
