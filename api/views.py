"""The records as clients see them; an attempt's lease token is never part of a view."""

import math
from collections.abc import Sequence
from datetime import datetime
from typing import Annotated, Any, Generic, Literal, Self, TypeVar
from urllib.parse import quote

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from core.jobs.job import Artifact, ArtifactRole, Job, Progress, UnreadableJob
from core.jobs.spec import SentSpec
from core.jobs.status import JobStatus
from core.jobs.waiting import what_it_waits_for
from core.jobs.workers import WorkerInfo
from core.reasons import Reason

Item = TypeVar("Item")


class View(BaseModel):
    """A document that the service returns."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class Listing(View, Generic[Item]):
    """A page of items, and the cursor of the next page; null at the end."""

    items: Sequence[Item]
    next: str | None = None


class ArtifactView(View):
    """A file of a job. size: bytes; href: where to fetch it; metadata: facts about how it was made."""

    name: str = Field(examples=["video.mp4"])
    role: ArtifactRole
    step: int | None
    media_type: str
    size: int
    sha256: str
    href: str
    metadata: dict[str, Any]

    @classmethod
    def of(cls, job_id: str, artifact: Artifact) -> Self:
        href = f"/jobs/{job_id}/artifacts/{quote(artifact.name, safe='')}"
        return cls(**artifact.model_dump(exclude={"key"}), href=href)


class AttemptView(View):
    """One attempt at the job by one worker. details: facts about its machine and its settings."""

    number: int
    worker: str
    device: str | None
    engine: str | None
    details: dict[str, Any]
    started_at: datetime
    ended_at: datetime | None
    reason: Reason | None
    message: str | None


class OriginView(View):
    """The service that a job was exported from. job: its id there; version: of Gaitway there."""

    job: str
    version: str
    imported_at: datetime


class JobView(View):
    """A job as it is now.

    spec: as it was sent, with the environment's options that it takes for its algorithm; the environment's
    tuned values apply where it names none. progress.phase: what a job does now that a worker holds; otherwise
    null.

    A record of another version that cannot be read has the reason `unreadable`, and neither attempts nor
    artifacts.
    """

    id: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    kind: str = Field(examples=["train"])
    name: str | None
    labels: dict[str, str]
    status: JobStatus
    reason: Reason | Literal["unreadable"] | None = Field(description="Why the job ended.")
    message: str | None = Field(description="The reason as a sentence for people.")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    not_before: datetime | None = Field(
        None, description="When a queued job is tried again; the pause grows with each failed attempt."
    )
    waiting_for: str | None = Field(
        None,
        description="What a queued job lacks, if no present worker could run it; only `GET` returns it.",
        examples=["No worker has exactly 4 GPUs: the workers here have cpu, gpu:0."],
    )
    imported_from: OriginView | None = Field(
        None,
        description="Where an imported job was run. Ids in its `spec` are of that service; `attempts` and "
        "times are those of the run there.",
    )
    progress: Progress
    attempts: Sequence[AttemptView]
    artifacts: Sequence[ArtifactView]
    spec: SentSpec | dict[str, Any]
    links: dict[str, str]

    @classmethod
    def of(cls, job: Job | UnreadableJob, workers: Sequence[WorkerInfo] | None = None) -> Self:
        """workers: the present ones, for a view that says what the job waits for."""
        if isinstance(job, UnreadableJob):
            return cls._of_unreadable(job)
        return cls(
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
            progress=job.progress if job.status.is_held else job.progress.model_copy(update={"phase": None}),
            attempts=[AttemptView.model_validate(attempt) for attempt in job.attempts],
            artifacts=[ArtifactView.of(job.id, artifact) for artifact in job.artifacts],
            spec=job.spec,
            links=_links(job),
        )

    @classmethod
    def _of_unreadable(cls, job: UnreadableJob) -> Self:
        return cls(
            **job.model_dump(include={"id", "kind", "name", "labels", "status", "spec"}),
            reason="unreadable",
            message=f"This version of Gaitway cannot read the job's record ({job.problem}).",
            created_at=job.created_at,
            started_at=job.started_at,
            finished_at=job.finished_at,
            progress=Progress(),
            attempts=(),
            artifacts=(),
            links=_links(job),
        )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


class MetricsRow(View):
    """Metrics of one step, under Brax's names; null where a value was not finite."""

    step: int
    time: datetime
    values: dict[str, Annotated[float | None, AfterValidator(_finite)]] = Field(
        examples=[{"eval/episode_reward": 1.0}]
    )


class Metrics(View):
    """Rows in the order of measurement; next: send it as `after` to get only later rows."""

    rows: Sequence[MetricsRow]
    next: str | None = None


class Health(View):
    """status: `ok`; anything else is a problem."""

    status: str = "ok"


def _links(job: Job | UnreadableJob) -> dict[str, str]:
    here = f"/jobs/{job.id}"
    parts = ["events", "metrics", "logs", "checkpoints", "artifacts", "policy", "video", "poster"]
    parts += ["replay", "specification", "export", "curve"]
    links = {"self": here, **{part: f"{here}/{part}" for part in parts}}
    links["report"] = f"{here}/report.html"
    return links if job.status.is_final else {**links, "cancel": f"{here}/cancel"}
