"""Between a job and its rows."""

import json
from collections.abc import Iterable, Sequence
from datetime import timedelta
from typing import Any, cast

import structlog
from pydantic import ValidationError
from pydantic_core import from_json
from sqlalchemy import Row

from core.jobs.job import Artifact, Attempt, Job, Progress, UnreadableJob
from core.jobs.status import JobStatus
from core.jobs.store import WorkerInfo
from core.jobs.stored_spec import read_spec

log = structlog.get_logger()

Values = dict[str, Any]


def job_values(job: Job) -> Values:
    """The columns of `jobs` that belong to this version; the counters and the lease belong to the store."""
    return {
        "version": job.version,
        "status": job.status.value,
        "reason": job.reason,
        "message": words(job.message),
        "started_at": job.started_at,
        "finished_at": job.finished_at,
        "not_before": job.not_before,
        "token": job.token,
        "num_attempts": len(job.attempts),
    }


def new_job_values(job: Job) -> Values:
    """All columns of a job that was not there before."""
    spec = job.spec
    return {
        **job_values(job),
        "id": job.id,
        "kind": spec.kind,
        "environment": spec.environment.id,
        "name": spec.name,
        "labels": spec.labels,
        "model": _text(spec.environment.options.get("model")),
        "source": None if spec.source is None else spec.source.job,
        "source_step": None if spec.source is None else spec.source.step,
        "spec": json.dumps(job.model_dump(mode="json", include={"spec"})["spec"]),
        "created_at": job.created_at,
        "progress": None if job.progress == Progress() else job.progress.model_dump_json(),
    }


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


def attempt_values(job_id: str, attempt: Attempt) -> Values:
    said = attempt.model_dump()
    return {
        **said,
        "job_id": job_id,
        "message": words(attempt.message),
        "details": json.dumps(attempt.model_dump(mode="json")["details"]),
    }


def artifact_values(job_id: str, position: int, artifact: Artifact) -> Values:
    facts = json.dumps(artifact.model_dump(mode="json")["metadata"])
    return {**artifact.model_dump(), "job_id": job_id, "position": position, "metadata": facts}


def artifact_of(row: Row[Any]) -> Artifact:
    return Artifact(
        name=row.name,
        role=row.role,
        media_type=row.media_type,
        size=row.size,
        sha256=row.sha256,
        key=row.key,
        step=row.step,
        metadata=from_json(row.metadata),
    )


def _attempt_of(row: Row[Any]) -> Attempt:
    return Attempt(
        number=row.number,
        token=row.token,
        worker=row.worker,
        device=row.device,
        engine=row.engine,
        details=from_json(row.details),
        started_at=row.started_at,
        ended_at=row.ended_at,
        reason=row.reason,
        message=row.message,
    )


def read_job(
    row: Row[Any], attempts: Sequence[Row[Any]], artifacts: Sequence[Row[Any]]
) -> Job | UnreadableJob:
    """The job; or what its columns tell, where the rest is of another version or damaged."""
    try:
        return Job(
            id=row.id,
            version=row.version,
            spec=read_spec(row.spec),
            status=row.status,
            reason=row.reason,
            message=row.message,
            created_at=row.created_at,
            started_at=row.started_at,
            finished_at=row.finished_at,
            not_before=row.not_before,
            attempts=tuple(_attempt_of(attempt) for attempt in attempts),
            artifacts=tuple(artifact_of(artifact) for artifact in artifacts),
            progress=_progress(row.progress),
        )
    except ValueError as error:  # JSON's and pydantic's errors are of this kind.
        return _unreadable(row, error)


def _progress(text: str | None) -> Progress:
    try:
        return Progress.model_validate_json(text) if text else Progress()
    except ValidationError:  # The next report replaces it.
        return Progress()


def _unreadable(row: Row[Any], error: ValueError) -> UnreadableJob:
    first = error.errors()[0] if isinstance(error, ValidationError) else None
    problem = f"{'/'.join(map(str, first['loc']))}: {first['msg']}" if first else str(error)
    try:
        spec = json.loads(row.spec)
    except ValueError:
        spec = {}
    return UnreadableJob(
        id=row.id,
        version=row.version,
        kind=row.kind,
        name=row.name,
        labels=row.labels,
        status=status(row.status),
        created_at=row.created_at,
        started_at=row.started_at,
        finished_at=row.finished_at,
        spec=cast("dict[str, Any]", spec) if isinstance(spec, dict) else {},
        problem=problem,
    )


def read_workers(texts: Iterable[str]) -> list[WorkerInfo]:
    """All that this version understands: one of another version hides no other."""
    found: list[WorkerInfo] = []
    for text in texts:
        try:
            found.append(WorkerInfo.model_validate_json(text))
        except ValidationError as error:
            log.warning("worker_unreadable", problem=str(error))
    return found


def status(text: str) -> JobStatus:
    """One that this version does not know is taken for `running`, so that nobody deletes the job."""
    try:
        return JobStatus(text)
    except ValueError:
        return JobStatus.RUNNING


def words(text: str | None) -> str | None:
    """What a process said of its end, which may be the tail of a log; text in PostgreSQL has no U+0000."""
    return None if text is None else text.replace("\0", "\N{REPLACEMENT CHARACTER}")


def interval(span: timedelta) -> timedelta:
    """At least a millisecond: PostgreSQL would take less for nothing at all."""
    return max(span, timedelta(milliseconds=1))
