"""What the client returns. Unknown members are ignored: a newer service may send more."""

from collections.abc import Collection, Iterator
from datetime import datetime
from typing import Any, Generic, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr

FINAL_STATUSES = frozenset({"succeeded", "failed", "cancelled"})

Item = TypeVar("Item")


class View(BaseModel):
    """A document of the service, as a frozen value."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class ArtifactView(View):
    """A file of a job. size: bytes; href: its path on the service."""

    name: str
    role: str | None = None
    media_type: str = "application/octet-stream"
    size: int
    sha256: str
    step: int | None = None
    href: str
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any])

    def __repr__(self) -> str:
        return f"<Artifact {self.name} {self.media_type} {self.size} bytes>"


class ProgressView(View):
    """How far a job is. step, total: environment steps; eta_s: seconds; metrics: latest by Brax's names.

    phase: what it does now: preparing, compiling, training, evaluating, acting or drawing.
    """

    step: int = 0
    total: int = 0
    steps_per_second: float | None = None
    eta_s: float | None = None
    metrics: dict[str, float | None] = Field(default_factory=dict[str, float | None])
    phase: str | None = None


class AttemptView(View):
    """One attempt at a job by one worker."""

    number: int
    worker: str | None = None
    device: str | None = None
    engine: str | None = None
    details: dict[str, Any] = Field(default_factory=dict[str, Any])
    started_at: datetime | None = None
    ended_at: datetime | None = None
    reason: str | None = None
    message: str | None = None


class OriginView(View):
    """The service that a job was exported from. job: its id there; version: of Gaitway there."""

    job: str
    version: str
    imported_at: datetime


class JobView(View):
    """A job as it was when it was read; read it again for news.

    A notebook's cell that ends with it shows its status, its curve and its newest video; `show` follows it.
    """

    id: str
    kind: str
    name: str | None = None
    labels: dict[str, str] = Field(default_factory=dict[str, str])
    status: str
    reason: str | None = None
    message: str | None = None
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
    not_before: datetime | None = None
    waiting_for: str | None = None
    imported_from: OriginView | None = None
    progress: ProgressView = ProgressView()
    attempts: tuple[AttemptView, ...] = ()
    artifacts: tuple[ArtifactView, ...] = ()
    spec: dict[str, Any] = Field(default_factory=dict[str, Any])
    links: dict[str, Any] = Field(default_factory=dict[str, Any])
    _service: str | None = PrivateAttr(None)

    def of(self, service: str) -> Self:
        """The same job, which knows the address of its service."""
        job = self.model_copy()
        job._service = service
        return job

    def show(self, *, every_s: float = 1.0) -> None:
        """Follow it in a notebook, below the cell, until it ends; as `Client.show`."""
        from gaitway.client import Client

        with Client(self._service) as client:
            client.show(self.id, every_s=every_s)

    def _repr_html_(self) -> str:
        from gaitway.client import card_of
        from gaitway.notebook import job_html

        return job_html(self, card_of(self, self._service))

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

    def newest(self, role: str, step: int | None = None) -> ArtifactView | None:
        """The artifact of this role with the highest step, or of exactly `step`.

        One without a step was made at the end.
        """
        found = [a for a in self.artifacts if a.role == role and step in (None, a.step)]
        return max(found, key=lambda a: float("inf") if a.step is None else a.step, default=None)

    def __repr__(self) -> str:
        parts = [self.id, self.kind, str(self.environment), self.status]
        if self.reason and self.reason != "completed":
            parts.append(f"({self.reason})")
        if self.progress.total:
            parts.append(f"{self.progress.step:,}/{self.progress.total:,} steps")
        return f"<Job {' '.join(parts)}>"

    __str__ = __repr__


class Page(View, Generic[Item]):
    """Some items, and the cursor of the next page (None at the end)."""

    items: list[Item]
    next: str | None = None

    def __iter__(self) -> Iterator[Item]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return iter(self.items)

    def __len__(self) -> int:
        return len(self.items)


class Event(View):
    """Something that happened to a job. kind: status, progress, metrics, artifact, phase, or line."""

    id: str = ""
    kind: str
    time: datetime | None = None
    data: dict[str, Any] = Field(default_factory=dict[str, Any])

    @property
    def is_end(self) -> bool:
        """Whether the job has ended with this."""
        return self.kind == "status" and self.data.get("status") in FINAL_STATUSES


class MetricsRow(View):
    """Metrics of one step, under Brax's names; None where a value was not finite."""

    step: int
    time: datetime | None = None
    values: dict[str, float | None] = Field(default_factory=dict[str, float | None])

    def only(self, names: Collection[str]) -> Self:
        """The row with these metrics alone; without names, with all."""
        kept = {name: value for name, value in self.values.items() if name in names}
        return self.model_copy(update={"values": kept}) if names else self


class SliceView(View):
    """Numbers of an observation or an action, from `start` on. components: their names, where known.

    low, high: bounds of an observation's; what -1 and 1 of an action's set.
    """

    name: str
    start: int
    size: int
    unit: str | None = None
    low: float | None = None
    high: float | None = None
    components: tuple[str, ...] = ()


class EnvironmentView(BaseModel):
    """An environment of the catalog; other members that the service sends are kept as attributes.

    observation, action: their numbers in order; in a list of environments they are left out.
    """

    model_config = ConfigDict(frozen=True, extra="allow")

    id: str
    description: str = ""
    family: str = ""
    observation: tuple[SliceView, ...] = ()
    action: tuple[SliceView, ...] = ()


class ModelView(View):
    """A user's own model. status: validating, ready or refused; description: its contents."""

    id: str
    name: str | None = None
    status: str
    media_type: str = ""
    size: int = 0
    created_at: datetime | None = None
    description: dict[str, Any] | None = None
    message: str | None = None


class StillView(View):
    """A still of an environment. camera: as a job's `video` names it; href: the PNG's path on the service."""

    camera: str | int
    size: int = 0
    href: str


class PreviewView(View):
    """An environment as an episode begins. options: all of them, with defaults; stills: one per camera."""

    environment: str
    options: dict[str, Any] = Field(default_factory=dict[str, Any])
    status: str
    stills: tuple[StillView, ...] = ()


class WorkerView(View):
    """A worker that has sent a heartbeat lately. job: the one that it took from the queue.

    jobs: all that it runs, which may be several trials of a sweep. state: ready, testing or device_failed;
    problem: what was wrong with its device. memory_bytes: of each of its devices, where known. packages: the
    optional ones that it has; None where it did not report them.
    """

    name: str
    host: str = ""
    pid: int | None = None
    device: str = ""
    queues: tuple[str, ...] = ()
    job: str | None = None
    jobs: tuple[str, ...] = ()
    state: str = "ready"
    problem: str | None = None
    memory_bytes: int | None = None
    packages: tuple[str, ...] | None = None
    started_at: datetime | None = None
    seen_at: datetime | None = None
