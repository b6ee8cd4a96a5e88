"""The records as clients see them; an attempt's lease token is never part of a view."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from typing import Annotated, Any, Generic, Literal, Self, TypeVar, get_args
from urllib.parse import quote

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from core.algorithms.catalog import ALGORITHMS, environment_options, resolve, tuned
from core.environments.info import Device, EnvironmentInfo
from core.environments.spaces import Slice
from core.errors import Rejected
from core.jobs.job import Artifact, ArtifactRole, Job, Progress, UnreadableJob
from core.jobs.spec import SentSpec
from core.jobs.status import JobStatus
from core.jobs.store import WorkerInfo
from core.jobs.waiting import what_it_waits_for
from core.physics.availability import EngineName
from core.reasons import Reason
from core.rendering.camera import TRACK

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
    tuned values apply where it names none.

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
            progress=job.progress,
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


class EnvironmentView(View):
    """An environment. dt: seconds between actions; options: their JSON Schema.

    tuned: hyperparameters that fit it, by algorithm and device. environment_options: by algorithm, the
    options that a job takes where it leaves them out, because `tuned` is made for them. family: `gaitway`, or
    the package that provides it. cannot_run: engines that cannot run it, each with the reason.
    Sizes and dt are null where they depend on the model that the options name.
    """

    id: str
    family: str
    description: str
    observation_size: int | None
    action_size: int | None
    dt: float | None
    episode_length: int
    cameras: Sequence[str]
    options: dict[str, Any]
    tuned: Mapping[str, Mapping[Device, Mapping[str, Any]]]
    environment_options: Mapping[str, Mapping[str, Any]]
    cannot_run: Mapping[EngineName, str]

    @classmethod
    def of(cls, info: EnvironmentInfo) -> Self:
        return cls(
            id=info.id,
            family=info.family,
            description=info.description,
            observation_size=info.observation_size,
            action_size=info.action_size,
            dt=info.dt,
            episode_length=info.episode_length,
            cameras=[TRACK, *(name for name in info.cameras if name and name != TRACK)],
            options=info.options.model_json_schema(),
            tuned=_by_algorithm_and_device(lambda kind, device: tuned(kind, _row_for(kind, info), device)),
            environment_options={kind: taken for kind in ALGORITHMS if (taken := _taken(kind, info))},
            cannot_run=info.cannot_run,
        )


class EnvironmentDetails(EnvironmentView):
    """An environment under the given options, and what a job on it gets by default.

    defaults: every hyperparameter of a job that sets none, by algorithm and device. An algorithm that needs
    more than its defaults on this environment is left out.
    observation, action: their numbers in order, with units and bounds; empty where they depend on a model
    that the options do not name.
    """

    observation: Sequence[Slice]
    action: Sequence[Slice]
    defaults: Mapping[str, Mapping[Device, Mapping[str, Any]]]

    @classmethod
    def of(cls, info: EnvironmentInfo) -> Self:
        shown = EnvironmentView.of(info)
        return cls(
            **{name: getattr(shown, name) for name in EnvironmentView.model_fields},
            observation=info.spaces.observation,
            action=info.spaces.action,
            defaults=_by_algorithm_and_device(lambda kind, device: _defaults(kind, info, device)),
        )


class AlgorithmView(View):
    """An algorithm, and the JSON Schema of its hyperparameters."""

    kind: str
    description: str
    parameters: dict[str, Any]


class Health(View):
    """status: `ok`; anything else is a problem."""

    status: str = "ok"


def _by_algorithm_and_device(
    values: Callable[[str, Device], dict[str, Any]],
) -> dict[str, dict[Device, dict[str, Any]]]:
    """Without the algorithms and devices for which there are no values."""
    found: dict[str, dict[Device, dict[str, Any]]] = {}
    for kind in ALGORITHMS:
        for device in get_args(Device):
            if own := values(kind, device):
                found.setdefault(kind, {})[device] = own
    return found


def _taken(kind: str, info: EnvironmentInfo) -> Mapping[str, Any]:
    """Options that a job on the environment takes because neither it nor these options say them."""
    if info.takes_model:
        return {}
    return environment_options(
        ALGORITHMS[kind].spec(), info.id, info.option_values.model_dump(exclude_unset=True)
    )


def _row_for(kind: str, info: EnvironmentInfo) -> EnvironmentInfo:
    """The environment as a job with this algorithm gets it."""
    if not (taken := _taken(kind, info)):
        return info
    given = info.option_values.model_dump(exclude_unset=True)
    return info.under(info.options.model_validate({**given, **taken}))


def _defaults(kind: str, info: EnvironmentInfo, device: Device) -> dict[str, Any]:
    """Every hyperparameter; none where the algorithm needs more than its defaults."""
    with suppress(Rejected):
        return resolve(ALGORITHMS[kind].spec(), _row_for(kind, info), device).model_dump(mode="json")
    return {}


def _links(job: Job | UnreadableJob) -> dict[str, str]:
    here = f"/jobs/{job.id}"
    parts = ["events", "metrics", "logs", "checkpoints", "artifacts", "policy", "video", "poster"]
    parts += ["replay", "specification", "export", "curve"]
    links = {"self": here, **{part: f"{here}/{part}" for part in parts}}
    links["report"] = f"{here}/report.html"
    return links if job.status.is_final else {**links, "cancel": f"{here}/cancel"}
