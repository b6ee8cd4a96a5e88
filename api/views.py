"""The documents of jobs, made of their records; an attempt's lease token is never part of one."""

from collections.abc import Sequence
from typing import Generic, TypeVar
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, TypeAdapter

from core.jobs.job import Artifact, Job, Progress, UnreadableJob
from core.jobs.spec import SentSpec
from core.jobs.workers import WorkerInfo, what_it_waits_for
from gaitway.schema import ArtifactView, AttemptView, JobView, OriginView, ProgressView

Item = TypeVar("Item")
_SENT_SPEC: TypeAdapter[SentSpec] = TypeAdapter(SentSpec)


class Answer(BaseModel):
    """A document that the service alone knows."""

    model_config = ConfigDict(frozen=True)


class Listing(Answer, Generic[Item]):
    """A page of items, and the cursor of the next page; null at the end."""

    items: Sequence[Item]
    next: str | None = None


class Health(Answer):
    """status: `ok`; anything else is a problem."""

    status: str = "ok"


def artifact_view(job_id: str, artifact: Artifact) -> ArtifactView:
    href = f"/jobs/{job_id}/artifacts/{quote(artifact.name, safe='')}"
    return ArtifactView(**artifact.model_dump(exclude={"key"}), href=href)


def job_view(job: Job | UnreadableJob, workers: Sequence[WorkerInfo] | None = None) -> JobView:
    """workers: the present ones, for a document that says what the job waits for."""
    if isinstance(job, UnreadableJob):
        return _unreadable_view(job)
    progress = job.progress if job.status.is_held else job.progress.model_copy(update={"phase": None})
    return JobView(
        id=job.id,
        kind=job.spec.kind,
        name=job.spec.name,
        labels=dict(job.spec.labels),
        status=job.status,
        reason=job.reason,
        message=job.message,
        created_at=job.created_at,
        started_at=job.started_at,
        finished_at=job.finished_at,
        not_before=job.not_before,
        waiting_for=None if workers is None else what_it_waits_for(job, workers),
        imported_from=None if job.imported_from is None else OriginView.model_validate(job.imported_from),
        progress=ProgressView.model_validate(progress),
        attempts=tuple(AttemptView.model_validate(attempt) for attempt in job.attempts),
        artifacts=tuple(artifact_view(job.id, artifact) for artifact in job.artifacts),
        spec=_SENT_SPEC.dump_python(job.spec, mode="json"),
        links=_links(job),
    )


def _unreadable_view(job: UnreadableJob) -> JobView:
    return JobView(
        **job.model_dump(include={"id", "kind", "name", "labels", "status", "spec"}),
        reason="unreadable",
        message=f"This version of Gaitway cannot read the job's record ({job.problem}).",
        created_at=job.created_at,
        started_at=job.started_at,
        finished_at=job.finished_at,
        progress=ProgressView.model_validate(Progress()),
        attempts=(),
        artifacts=(),
        links=_links(job),
    )


def _links(job: Job | UnreadableJob) -> dict[str, str]:
    here = f"/jobs/{job.id}"
    parts = ["events", "metrics", "logs", "checkpoints", "artifacts", "policy", "video", "poster"]
    parts += ["replay", "specification", "export", "curve"]
    links = {"self": here, **{part: f"{here}/{part}" for part in parts}}
    links["report"] = f"{here}/report.html"
    return links if job.status.is_final else {**links, "cancel": f"{here}/cancel"}
