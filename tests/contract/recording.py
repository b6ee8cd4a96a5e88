"""Jobs for the record, and what tests do to it behind its back instead of waiting."""

import secrets
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import Any

import psycopg

from core.clips.record import ClipFile
from core.jobs.job import Artifact, Job, new_job_id
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.store import Chunk, Entry, JobStore
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from core.user_models.record import ModelRecord

NOW = datetime(2026, 11, 21, 12, 0, 0, tzinfo=UTC)
LEASE = timedelta(seconds=30)
MODEL = "sha256:" + "0" * 64
CLIPS = f"sha256:{'c' * 64}"


def queued_job(at_s: int = 0, **said: object) -> Job:
    spec = JOB_SPEC.validate_python({"kind": "train", "environment": "ant", **said})
    created_at = NOW + timedelta(seconds=at_s)
    return Job(id=new_job_id(created_at), spec=spec, created_at=created_at)


def held(jobs: JobStore, job: Job) -> Job:
    """The job in `jobs`, held by its first attempt."""
    jobs.add(job)
    claimed = job.claimed("worker-1", NOW)
    jobs.save(claimed, lease=LEASE)
    return claimed


def cancelled(job: Job) -> Job:
    return job.ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "", NOW)


def taken_back(job: Job) -> Job:
    return job.requeued(Reason.WORKER_LOST, "It was silent.", NOW)


def statuses(jobs: JobStore, job: Job) -> list[Entry]:
    return [entry for entry in jobs.feed(job.id, "events").entries if entry.kind == "status"]


def at_once(steps: Sequence[Callable[[], object]], refusal: type[Exception]) -> list[bool]:
    """Take all steps at the same moment; whether each succeeded or was refused so."""
    together = threading.Barrier(len(steps))

    def take(step: Callable[[], object]) -> bool:
        together.wait()
        try:
            step()
        except refusal:
            return False
        return True

    with ThreadPoolExecutor(len(steps)) as pool:
        return list(pool.map(take, steps))


def line(text: str) -> Entry:
    return Entry(kind="line", time=NOW, data={"text": text})


def say(jobs: JobStore, job: Job, *lines: str) -> None:
    """As the attempt that holds the job does."""
    jobs.record(job.id, job.token, "logs", [line(text) for text in lines], write_id=secrets.token_hex(8))


def texts(entries: Iterable[Entry]) -> list[str]:
    return [entry.data["text"] for entry in entries]


def chunk_of(entries: Sequence[Entry], key: str = "chunk") -> Chunk:
    """Of entries in the logs; nobody looks into its object."""
    return Chunk("logs", int(entries[0].id), int(entries[-1].id), key, size=1, sha256="0" * 64)


def artifact(name: str, **said: Any) -> Artifact:
    facts = {"role": "picture", "media_type": "image/png", "size": 1, "sha256": "0" * 64, "key": f"of {name}"}
    return Artifact.model_validate({"name": name, **facts, **said})


def model(model_id: str = MODEL, **said: object) -> ModelRecord:
    facts = {"status": "ready", "media_type": "application/xml", "size": 7, "created_at": NOW}
    return ModelRecord.model_validate({"id": model_id, **facts, **said})


def clip_file(file_id: str = CLIPS, **said: object) -> ClipFile:
    facts = {"status": "ready", "media_type": "application/octet-stream", "size": 7, "created_at": NOW}
    return ClipFile.model_validate({"id": file_id, "sha256": "1" * 64, "body": "ant", **facts, **said})


def worker(name: str) -> WorkerInfo:
    return WorkerInfo(name=name, host="h", pid=1, device="cpu", started_at=NOW, seen_at=NOW)


class Database:
    """The record's tables."""

    def __init__(self, connection: psycopg.Connection[Any]) -> None:
        self._connection = connection

    def change(self, statement: str, *values: object) -> None:
        self._connection.execute(statement.encode(), values)

    def read(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        return self._connection.execute(statement.encode(), values).fetchall()

    def count(self, table: str) -> int:
        return self.read(f"SELECT count(*) FROM {table}")[0][0]  # noqa: S608

    def pass_time(self, span: timedelta) -> None:
        """To leases and to the pulse, so much time has passed."""
        self.change("UPDATE jobs SET lease_until = lease_until - %s", span)
        self.change("UPDATE pulse SET beat_at = beat_at - %s, quiet_until = quiet_until - %s", span, span)

    def end_lease(self, job: Job) -> None:
        self.change("UPDATE jobs SET lease_until = now() - interval '1 s' WHERE id = %s", job.id)

    def damage(self, job: Job, **columns: str) -> None:
        """Let columns of the job's row say something else."""
        for name, value in columns.items():
            self.change(f"UPDATE jobs SET {name} = %s WHERE id = %s", value, job.id)  # noqa: S608


def watch(jobs: JobStore, database: Database) -> None:
    """As if a reconciler had been looking at the leases all the time."""
    jobs.beat(LEASE)
    database.change("UPDATE pulse SET quiet_until = now() - interval '1 s'")
