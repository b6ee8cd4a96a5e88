"""Jobs, their files and their metrics."""

import math
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from gaitway.schema.base import FINAL_STATUSES, ArtifactRole, JobPhase, JobStatus, Reason, View


class ArtifactView(View):
    """A file of a job. size: bytes; href: where to fetch it; metadata: facts about how it was made."""

    name: str = Field(examples=["video.mp4"])
    role: ArtifactRole = ""
    step: int | None = None
    media_type: str = "application/octet-stream"
    size: int
    sha256: str
    href: str
    metadata: dict[str, Any] = {}

    def __repr__(self) -> str:
        return f"<Artifact {self.name} {self.media_type} {self.size} bytes>"


class ProgressView(View):
    """The progress of a running job. step, total: environment steps; eta_s: seconds.

    phase: what its attempt does now. `acting` is a rollout's word for training; `testing` is the battery.
    """

    step: int = 0
    total: int = 0
    steps_per_second: float | None = None
    eta_s: float | None = None
    metrics: dict[str, float | None] = {}
    phase: JobPhase | None = None


class AttemptView(View):
    """One attempt at the job by one worker. details: facts about its machine and its settings.

    peak_bytes: the most that it has had of a GPU's memory; null where that was not measured, as on a CPU.
    gpu_part: the part of the GPU's memory that it may take, where it shares the GPU; null where it has all.
    """

    number: int
    worker: str = ""
    device: str | None = None
    engine: str | None = None
    peak_bytes: int | None = None
    gpu_part: float | None = None
    details: dict[str, Any] = {}
    started_at: datetime
    ended_at: datetime | None = None
    reason: Reason | None = None
    message: str | None = None


class RemovedView(View):
    """Files of a job that a retention rule has removed. at: the last time."""

    rule: str = Field(examples=["videos_days"])
    at: datetime
    files: int
    bytes: int


class OriginView(View):
    """The service that a job was exported from. job: its id there; version: of Gaitway there."""

    job: str
    version: str
    imported_at: datetime


class TurnView(View):
    """Where a queued job stands. before: how many jobs start before it. reason: a sentence.

    starts_at: an estimate, by how long the jobs of each user took of late; null without one.
    """

    before: int
    reason: str
    starts_at: datetime | None = None


class JobView(View):
    """A job as it is now.

    spec: as it was sent, with the environment's options that it takes for its algorithm, and with its present
    name, labels and note; the environment's tuned values apply where it names none. progress.phase: what a
    job does now that a worker holds; otherwise null.

    A record of another version that cannot be read has the reason `unreadable`, and neither attempts nor
    artifacts.
    """

    id: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    kind: str = Field(examples=["train"])
    name: str | None = None
    labels: dict[str, str] = {}
    note: str | None = Field(None, description="Plain text about it, for people.")
    owner: str | None = Field(None, description="A user's name; null without accounts.")
    project: str = "default"
    status: JobStatus
    reason: Reason | Literal["unreadable"] | None = Field(None, description="Why the job ended.")
    message: str | None = Field(None, description="The reason as a sentence for people.")
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
    not_before: datetime | None = Field(
        None, description="When a queued job is tried again; the pause grows with each failed attempt."
    )
    waiting_for: str | None = Field(
        None,
        description="What a queued job lacks, if no present worker could run it; only `GET` returns it.",
        examples=["No worker has exactly 4 GPUs: the workers here have cpu, gpu:0."],
    )
    turn: TurnView | None = Field(None, description="When a queued job should start; only `GET` returns it.")
    sweep: str | None = Field(None, description="The id of its sweep; only `GET` returns it.")
    imported_from: OriginView | None = Field(
        None,
        description="Where an imported job was run. Ids in its `spec` are of that service; `attempts` and "
        "times are those of the run there.",
    )
    removed: tuple[RemovedView, ...] = Field(
        (), description="Its files that retention rules of the project have removed."
    )
    correlation_id: str | None = Field(
        None,
        description="By which the logs of all processes name the job: the `X-Request-ID` of the request that "
        "submitted it, or the id of its sweep.",
        examples=["5f0c9a3e1b7d2468"],
    )
    progress: ProgressView = ProgressView()
    attempts: tuple[AttemptView, ...] = ()
    artifacts: tuple[ArtifactView, ...] = ()
    spec: dict[str, Any] = {}
    links: dict[str, str] = {}

    @property
    def is_final(self) -> bool:
        """Whether the job has ended."""
        return self.status in FINAL_STATUSES

    @property
    def succeeded(self) -> bool:
        return self.status == "succeeded"

    @property
    def environment(self) -> str | None:
        """The environment's id."""
        chosen = self.spec.get("environment")
        return chosen.get("id") if isinstance(chosen, dict) else chosen  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]

    def artifact(self, name: str) -> ArtifactView | None:
        """The file of this name."""
        return next((artifact for artifact in self.artifacts if artifact.name == name), None)

    @property
    def seeds(self) -> list[int]:
        """The seeds that it trains side by side; empty for one that trains a single seed, or none."""
        return self.spec.get("seeds") or []

    def newest(self, role: str, step: int | None = None, seed: int | None = None) -> ArtifactView | None:
        """The artifact of this role with the highest step, or of exactly `step`.

        One without a step was made at the end. seed: whose, of several; by default the first's.
        """
        wanted = self.seeds[0] if seed is None and self.seeds else seed
        fitting = [
            a
            for a in self.artifacts
            if a.role == role and step in (None, a.step) and a.metadata.get("seed", wanted) == wanted
        ]
        return max(fitting, key=lambda a: float("inf") if a.step is None else a.step, default=None)

    def __repr__(self) -> str:
        parts = [self.id, self.kind, str(self.environment), self.status]
        if self.reason and self.reason != "completed":
            parts.append(f"({self.reason})")
        if self.progress.total:
            parts.append(f"{self.progress.step:,}/{self.progress.total:,} steps")
        return f"<Job {' '.join(parts)}>"

    __str__ = __repr__


class OutcomeView(View):
    """What became of one of many jobs. result: `cancelled`, `cancelling`, `deleted`, or `refused`.

    code, message: of the refusal, as a problem of that job alone would have them.
    """

    job: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    result: str = Field(examples=["cancelled"])
    code: str | None = None
    message: str | None = None


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


class MetricsRow(View):
    """Metrics of one step, under Brax's names; null where a value was not finite."""

    step: int
    time: datetime
    values: dict[str, Annotated[float | None, AfterValidator(_finite)]] = Field(
        {}, examples=[{"eval/episode_reward": 1.0}]
    )


class Metrics(View):
    """Rows in the order of measurement; next: send it as `after` to get only later rows."""

    rows: list[MetricsRow]
    next: str | None = None
