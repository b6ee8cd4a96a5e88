"""The jobs and models that version 0.1 stored. `gaitway import-0.1` reads them; nothing here writes.

Redis had the live records:

gaitway:job:<id>          hash: version, document (the job as JSON), progress, …
gaitway:job:<id>:events   stream of entries, as is :logs
gaitway:jobs              sorted set of every id
gaitway:idempotency:<h>   hash: fingerprint, job; expires after a day
gaitway:worker:<name>     a worker's announcement; expires; gaitway:workers is the set of names

The object store had copies:

jobs/<id>/spec.json                       the job as it was submitted; written first, and removed with the job
jobs/<id>/record.json                     the job after its newest transition that mattered
jobs/<id>/attempts/<n>/manifest.json      the artifacts of an attempt, written after its files
models/<hash>/record.json                 a user's own model; there was no other record of it
"""

import json
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cached_property
from itertools import chain
from typing import Any

from pydantic import ValidationError
from redis import Redis

from core.adapters.postgres.submissions import SeenKey
from core.adapters.redis.errors import reaching_redis
from core.documents import Stored
from core.errors import JobNotFound, JobUnreadable, ObjectNotFound
from core.jobs.entries import status_entry
from core.jobs.job import Artifact, Job, Progress, check_job_id
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry
from core.jobs.stored_spec import read_spec
from core.reasons import Reason
from core.storage import keys
from core.storage.objects import ObjectStore
from core.user_models.record import ModelRecord

_IMPORTED = "Version 0.1 was stopped during this attempt, and its data were imported into a newer version."
_PAGE = 1000
_OF_ATTEMPT = re.compile(r"jobs/[^/]+/attempts/([0-9]+)/")


@dataclass(frozen=True)
class OldJob:
    """A job as the record will hold it, ended or queued, with its feeds and keys."""

    job: Job
    events: Iterable[Entry]
    logs: Iterable[Entry]
    keys: Sequence[SeenKey]


@dataclass(frozen=True)
class _Copy:
    """A job as JSON. version: 0 if even that cannot be read."""

    version: int
    document: bytes
    progress: bytes | None = None


class _Manifest(Stored):
    artifacts: list[Artifact] = []


class _Measured(Stored):
    """A line of metrics.jsonl."""

    step: int
    time: datetime
    values: dict[str, float | None]


class Version01:
    """The data of version 0.1. redis: None if its data in Redis are lost.

    Every method raises RecordsUnavailable and StorageUnavailable.
    """

    def __init__(self, redis: "Redis | None", objects: ObjectStore) -> None:
        self._redis: Any = redis
        self._objects = objects

    @reaching_redis()
    def workers(self) -> Sequence[str]:
        """The names of workers that were active within the last minute."""
        if self._redis is None:
            return []
        names = sorted(name.decode() for name in self._redis.smembers("gaitway:workers"))
        return [name for name in names if self._redis.exists(f"gaitway:worker:{name}")]

    @reaching_redis()
    def live_job_ids(self) -> Collection[str]:
        """The ids of the jobs in Redis; some may have been deleted since."""
        if self._redis is None:
            return []
        return {job_id.decode() for job_id in self._redis.zrange("gaitway:jobs", 0, -1)}

    def job_ids(self) -> Sequence[str]:
        """The ids of all jobs that are not deleted, oldest first."""
        found = [info.key.split("/") for info in self._objects.list(keys.jobs())]
        return sorted(parts[1] for parts in found if parts[2:] == ["spec.json"] and _is_job_id(parts[1]))

    def read(self, job_id: str, now: datetime) -> OldJob:
        """The job, without the attempt that held it. Raises JobUnreadable."""
        try:
            job = self._newest(job_id)
            if not job.status.is_final:
                job = self._with_published(job)
            left = _let_go(job, now)
            last = [status_entry(left)] if left.status != job.status else []
            events = self._stream(job_id, "events") or self._retold_events(job)
            logs = self._stream(job_id, "logs") or self._retold_logs(job)
        except ValueError as error:  # JSON's and pydantic's errors are of this kind.
            raise JobUnreadable(job_id, _problem(error)) from error
        return OldJob(left, chain(events, last), logs, self._seen_keys.get(job_id, []))

    def model_ids(self) -> Sequence[str]:
        """The ids of all models, made of their hashes."""
        found = [info.key.split("/") for info in self._objects.list(keys.models())]
        return [f"sha256:{parts[1]}" for parts in found if parts[2:] == ["record.json"]]

    def read_model(self, model_id: str) -> ModelRecord:
        """Raises ValueError, whose message is a sentence."""
        try:
            record = ModelRecord.model_validate_json(self._objects.get(f"{keys.model(model_id)}record.json"))
        except ValidationError as error:
            raise ValueError(_problem(error)) from error
        if record.id != model_id:
            raise ValueError(f"it belongs to model {record.id[:80]}")
        return record

    # ---- records ---------------------------------------------------------------------------------

    def _newest(self, job_id: str) -> Job:
        """The newer of Redis' document and its copy, or the submission: an older one would be wrong."""
        copies = [*self._in_redis(job_id), *self._in_bucket(keys.record(job_id))]
        copies = copies or [*self._in_bucket(f"{keys.job(job_id)}spec.json")]
        newest = max((copy.version for copy in copies), default=0)
        equal = [copy for copy in copies if copy.version == newest]
        for copy in equal[:-1]:
            with suppress(ValueError):
                return _job(job_id, copy)
        if not equal:
            raise ValueError("it was deleted a moment ago")
        return _job(job_id, equal[-1])

    @reaching_redis()
    def _in_redis(self, job_id: str) -> list[_Copy]:
        if self._redis is None:
            return []
        key = f"gaitway:job:{job_id}"
        version, document, progress = self._redis.hmget(key, "version", "document", "progress")
        return [] if document is None else [_Copy(int(version or 0), document, progress)]

    def _in_bucket(self, key: str) -> list[_Copy]:
        try:
            document = self._objects.get(key)
        except ObjectNotFound:
            return []
        try:
            version = int(json.loads(document)["version"])
        except (ValueError, KeyError, TypeError):
            version = 0
        return [_Copy(version, document)]

    def _with_published(self, job: Job) -> Job:
        """The job with artifacts that only manifests name: copies of the record may be older than these."""
        sizes = {info.key: info.size for info in self._objects.list(keys.job(job.id))}
        named: list[Artifact] = []
        for attempt in job.attempts:
            key = f"{keys.job(job.id)}attempts/{attempt.number}/manifest.json"
            if key in sizes:
                named += _Manifest.model_validate_json(self._objects.get(key)).artifacts
        published = _published(job.artifacts, named, sizes)
        return job if published == job.artifacts else job.next(artifacts=published)

    @cached_property
    def _seen_keys(self) -> Mapping[str, list[SeenKey]]:
        """The keys of each job's submission that are still remembered."""
        found: dict[str, list[SeenKey]] = defaultdict(list)
        if self._redis is None:
            return found
        with reaching_redis():
            for key in self._redis.scan_iter(match="gaitway:idempotency:*", count=_PAGE):
                fingerprint, job_id = self._redis.hmget(key, "fingerprint", "job")
                left_ms = self._redis.pttl(key)
                if fingerprint is not None and job_id is not None and left_ms > 0:
                    name, mark = key.decode().rpartition(":")[2], fingerprint.decode().removeprefix("=")
                    found[job_id.decode()].append(SeenKey(name, mark, timedelta(milliseconds=left_ms)))
        return found

    # ---- feeds -----------------------------------------------------------------------------------

    @reaching_redis()
    def _stream(self, job_id: str, channel: Channel) -> Iterable[Entry]:
        """The feed's entries in Redis; empty if there are none."""
        key = f"gaitway:job:{job_id}:{channel}"
        return self._entries(key, channel) if self._redis is not None and self._redis.exists(key) else ()

    def _entries(self, key: str, channel: Channel) -> Iterator[Entry]:
        start = "-"
        while True:
            with reaching_redis():
                page: list[Any] = self._redis.xrange(key, min=start, count=_PAGE)
            for at, said in page:
                yield _entry(at.decode(), said, channel)
            if len(page) < _PAGE:
                return
            start = f"({page[-1][0].decode()}"

    def _retold_events(self, job: Job) -> Sequence[Entry]:
        """Entries for the job's metrics and for its end, made from its artifacts."""
        measured: list[Entry] = []
        for line in self._lines(job.newest("metrics")):
            with suppress(ValidationError):
                row = _Measured.model_validate_json(line)
                measured.append(
                    Entry(kind="metrics", time=row.time, data={"step": row.step, "values": row.values})
                )
        if job.finished_at is None:
            return measured
        return [*measured, status_entry(job, job.finished_at)]

    def _retold_logs(self, job: Job) -> Sequence[Entry]:
        time = job.finished_at or job.created_at
        return [Entry(kind="line", time=time, data={"text": line}) for line in self._lines(job.newest("log"))]

    def _lines(self, artifact: Artifact | None) -> Sequence[str]:
        if artifact is None:
            return []
        try:
            text = self._objects.get(artifact.key).decode(errors="replace")
        except ObjectNotFound:
            return []
        return text.removesuffix("\n").split("\n")


def _is_job_id(text: str) -> bool:
    try:
        return check_job_id(text) == text
    except JobNotFound:
        return False


def _job(job_id: str, copy: _Copy) -> Job:
    """Raises ValueError."""
    document = json.loads(copy.document)
    if not isinstance(document, dict):
        raise ValueError("it is not a JSON object")
    said: dict[str, Any] = {**document}
    try:
        spec = read_spec(json.dumps(said.get("spec")))
    except ValueError as error:
        raise ValueError(f"its specification: {_problem(error)}") from error
    progress = json.loads(copy.progress) if copy.progress else said.get("progress")
    job = Job.model_validate({**said, "spec": spec, "progress": _progress(progress)})
    if job.id != job_id:
        raise ValueError(f"it belongs to job {job.id[:64]}")
    return job


def _progress(said: Any) -> Progress:
    """The progress without nulls, as which version 0.1 stored values that were not finite."""
    try:
        metrics = {name: value for name, value in said["metrics"].items() if value is not None}
        return Progress.model_validate({**said, "metrics": metrics})
    except (ValidationError, KeyError, TypeError, AttributeError):
        return Progress()


def _published(
    recorded: Sequence[Artifact], named: Sequence[Artifact], sizes: Mapping[str, int]
) -> tuple[Artifact, ...]:
    """For each name, the newest artifact whose file exists.

    sizes: the size of each object of the job, by key. Manifests and copies of the record also name
    checkpoints that were removed later.
    """
    best: dict[str, tuple[tuple[bool, int, bool], Artifact]] = {}
    for artifact in (*recorded, *named):
        is_recorded, is_whole = artifact in recorded, sizes.get(artifact.key) == artifact.size
        rank = (is_whole, _attempt_of(artifact), is_recorded)
        is_there = is_whole or (is_recorded and artifact.key in sizes)
        if is_there and (artifact.name not in best or rank > best[artifact.name][0]):
            best[artifact.name] = (rank, artifact)
    return tuple(artifact for _, artifact in best.values())


def _let_go(job: Job, now: datetime) -> Job:
    """The job without the attempt that held it. A cancelling job is ended here, because no worker will."""
    if job.status == JobStatus.CANCELLING:
        return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, f"Cancelled. {_IMPORTED}", now)
    if job.status.is_held:
        return job.requeued(Reason.WORKER_LOST, _IMPORTED, now)
    return job


def _attempt_of(artifact: Artifact) -> int:
    found = _OF_ATTEMPT.match(artifact.key)
    return int(found[1]) if found else 0


def _entry(at: str, said: Mapping[bytes, bytes], channel: Channel) -> Entry:
    """at: the id of the entry in the stream, which begins with the time in milliseconds."""
    try:
        return Entry.model_validate_json(said.get(b"entry", b"")).model_copy(update={"id": ""})
    except ValidationError:
        kind = "note" if channel == "events" else "line"
        time = datetime.fromtimestamp(int(at.partition("-")[0]) / 1000, UTC)
        return Entry(kind=kind, time=time, data={"text": "An entry of version 0.1 could not be read."})


def _problem(error: ValueError) -> str:
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors()[0]
    place = "/".join(map(str, first["loc"]))
    return f"{place}: {first['msg']}" if place else first["msg"]
