"""Jobs to rows, and rows to jobs."""

import json
from collections.abc import Sequence
from datetime import timedelta
from typing import Any, cast

from pydantic import ValidationError
from pydantic_core import from_json
from sqlalchemy import Row

from core.bounds import LONGEST_MESSAGE
from core.jobs.job import Artifact, Attempt, Job, Progress, UnreadableJob
from core.jobs.queue import queue_of
from core.jobs.status import JobStatus
from core.jobs.stored_spec import read_spec

Values = dict[str, Any]


def job_values(job: Job) -> Values:
    """The columns of `jobs` that change with the version; the store adds the counters and the lease."""
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
        "queue": queue_of(job),
    }


def new_job_values(job: Job) -> Values:
    """All columns of a new job."""
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
        "imported_from": None if job.imported_from is None else job.imported_from.model_dump_json(),
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


def columns(row: Row[Any]) -> Values:
    return dict(row._mapping)  # pyright: ignore[reportPrivateUsage] # Public, by SQLAlchemy's documentation.


def read_job(
    row: Row[Any], attempts: Sequence[Row[Any]], artifacts: Sequence[Row[Any]]
) -> Job | UnreadableJob:
    """The job; an UnreadableJob if its row is damaged or another version wrote it."""
    own = columns(row)
    try:
        found = {
            "spec": read_spec(row.spec),
            "attempts": [_attempt_of(attempt) for attempt in attempts],
            "artifacts": [_artifact_of(artifact) for artifact in artifacts],
            "progress": _progress(row.progress),
            "imported_from": None if row.imported_from is None else from_json(row.imported_from),
        }
        return Job.model_validate({**own, **found})
    except ValueError as error:  # JSON's and pydantic's errors are of this kind.
        found = {"status": status(row.status), "spec": _spec(row.spec), "problem": _problem(error)}
        return UnreadableJob.model_validate({**own, **found})


def _attempt_of(row: Row[Any]) -> Attempt:
    return Attempt.model_validate({**columns(row), "details": from_json(row.details)})


def _artifact_of(row: Row[Any]) -> Artifact:
    return Artifact.model_validate({**columns(row), "metadata": from_json(row.metadata)})


def _progress(text: str | None) -> Progress:
    try:
        return Progress.model_validate_json(text) if text else Progress()
    except ValidationError:  # The next report replaces it.
        return Progress()


def _spec(text: str) -> Values:
    try:
        spec = json.loads(text)
    except ValueError:
        return {}
    return cast("Values", spec) if isinstance(spec, dict) else {}


def _problem(error: ValueError) -> str:
    first = error.errors()[0] if isinstance(error, ValidationError) else None
    return f"{'/'.join(map(str, first['loc']))}: {first['msg']}" if first else str(error)


def status(text: str) -> JobStatus:
    """A status that this version does not know becomes `running`, so that nobody deletes the job."""
    try:
        return JobStatus(text)
    except ValueError:
        return JobStatus.RUNNING


def words(text: str | None) -> str | None:
    """A message, which may be the tail of a log, without U+0000: PostgreSQL does not store that as text."""
    if text is None:
        return None
    short = text if len(text) <= LONGEST_MESSAGE else f"{text[: LONGEST_MESSAGE - 1]}…"
    return short.replace("\0", "\N{REPLACEMENT CHARACTER}")


def interval(span: timedelta) -> timedelta:
    """At least a millisecond: PostgreSQL would round less to nothing."""
    return max(span, timedelta(milliseconds=1))
