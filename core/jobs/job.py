"""A job and its history as an immutable value: every step returns a new one."""

import re
import secrets
from collections.abc import Collection, Mapping
from datetime import UTC, datetime
from typing import Any, Literal, Self

from pydantic import Field

from core.accounts.principal import DEFAULT_PROJECT, Ownership
from core.documents import Stored
from core.errors import IllegalTransition, JobNotFound
from core.jobs.spec import Accelerator, SentSpec, TrainSpec
from core.jobs.status import LOSSES, NEXT, JobStatus
from core.reasons import Reason

JOB_ID = r"[0-9a-f]{12}-[0-9a-f]{10}"
_JOB_ID = re.compile(JOB_ID)

ArtifactRole = Literal[
    "checkpoint",
    "policy",
    "best_policy",
    "export",
    "video",
    "poster",
    "trajectory",
    "recording",
    "scene",
    "replay",
    "lost_body",
    "simulation",
    "summary",
    "battery",
    "metrics",
    "log",
    "tables",
    "picture",
    "tensorboard",
    "wandb",
]


def new_job_id(now: datetime) -> str:
    """An id that sorts by time: milliseconds since 1970 in hexadecimal, then 40 random bits."""
    return f"{int(now.timestamp() * 1000):012x}-{secrets.token_hex(5)}"


def check_job_id(text: str) -> str:
    """The same text; raises JobNotFound where it cannot be an id, so that it never becomes part of a key."""
    if _JOB_ID.fullmatch(text) is None:
        raise JobNotFound(text[:64])
    return text


def utc_now() -> datetime:
    return datetime.now(UTC)


class Artifact(Stored):
    """A file that clients may fetch. size: bytes; metadata: facts about how it was made."""

    name: str
    role: ArtifactRole
    media_type: str
    size: int
    sha256: str
    key: str
    step: int | None = None
    metadata: dict[str, Any] = Field(default_factory=dict)


JobPhase = Literal["preparing", "compiling", "training", "evaluating", "acting", "drawing", "testing"]


class Progress(Stored):
    """The progress of a running job. step, total: environment steps; eta_s: seconds.

    phase: what its attempt does now. `acting` is a rollout's word for training; `testing` is the battery.
    """

    step: int = 0
    total: int = 0
    steps_per_second: float | None = None
    eta_s: float | None = None
    metrics: dict[str, float] = Field(default_factory=dict)
    phase: JobPhase | None = None


class Attempt(Stored):
    """One attempt at a job by one worker. token: its writes must carry this.

    peak_bytes: the most that it has had of a GPU's memory, where that was measured. gpu_part: the part of the
    GPU's memory that it may take, where it shares the GPU.
    """

    number: int
    token: str
    worker: str
    device: str | None = None
    engine: str | None = None
    peak_bytes: int | None = None
    gpu_part: float | None = None
    details: dict[str, Any] = Field(default_factory=dict)
    started_at: datetime
    ended_at: datetime | None = None
    reason: Reason | None = None
    message: str | None = None


class Origin(Stored):
    """Where an imported job was run. job: its id on that service; version: of Gaitway there.

    Ids in the job's specification are those of that service.
    """

    job: str
    version: str
    imported_at: datetime


class Removed(Stored):
    """Files that a retention rule of the project has removed. at: the last time; size: bytes of all."""

    rule: str
    at: datetime
    files: int
    size: int


class UnreadableJob(Stored):
    """The readable part of a record that this version does not understand. problem: a sentence."""

    id: str
    version: int
    kind: str
    name: str | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    note: str | None = None
    status: JobStatus
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
    owner: str | None = None
    project: str = DEFAULT_PROJECT
    spec: dict[str, Any] = Field(default_factory=dict)
    problem: str


class Job(Stored):
    """The record. `version` rises by one with every step; the store refuses any other.

    not_before: when a queued job may be tried again, after an attempt that failed. owner: a user's name; None
    without accounts. correlation_id: of the request that submitted it, or the id of the sweep that began it;
    each process logs it. removed: by retention rules, which alone write it.
    """

    id: str
    version: int = 1
    spec: SentSpec
    status: JobStatus = JobStatus.QUEUED
    reason: Reason | None = None
    message: str | None = None
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
    not_before: datetime | None = None
    attempts: tuple[Attempt, ...] = ()
    artifacts: tuple[Artifact, ...] = ()
    progress: Progress = Progress()
    imported_from: Origin | None = None
    removed: tuple[Removed, ...] = ()
    owner: str | None = None
    project: str = DEFAULT_PROJECT
    correlation_id: str | None = None

    @property
    def ownership(self) -> Ownership:
        return Ownership(self.owner, self.project)

    @property
    def token(self) -> str:
        """The token that writes of the present attempt carry; empty when none holds the job."""
        return self.attempts[-1].token if self.status.is_held and self.attempts else ""

    @property
    def lost_attempts(self) -> int:
        """Attempts that count against `max_attempts`."""
        return self.num_ended(LOSSES)

    def num_ended(self, reasons: Collection[Reason]) -> int:
        """The number of attempts that ended for one of these reasons."""
        return sum(attempt.reason in reasons for attempt in self.attempts)

    @property
    def next_attempt(self) -> int:
        """The number of the attempt that a queued job waits for."""
        return len(self.attempts) + 1

    @property
    def begun(self) -> Attempt | None:
        """The newest attempt that reported its device, if the job has a checkpoint of its own."""
        if self.newest("checkpoint") is None:
            return None
        return next((attempt for attempt in reversed(self.attempts) if attempt.device), None)

    @property
    def device(self) -> str | None:
        """The device of the newest attempt that reported one."""
        return next((attempt.device for attempt in reversed(self.attempts) if attempt.device), None)

    @property
    def engine(self) -> str | None:
        """The physics engine of the newest attempt that reported one."""
        return next((attempt.engine for attempt in reversed(self.attempts) if attempt.engine), None)

    @property
    def accelerator(self) -> Accelerator:
        """The kind of device that the next attempt needs: the kind that made the job's checkpoint, if any.

        Tuned settings differ by device, and a checkpoint fits only the settings under which it was made.
        """
        wanted, begun = self.spec.resources.kind, self.begun
        if wanted != "any" or begun is None or begun.device is None:
            return wanted
        return "cpu" if begun.device.startswith("cpu") else "gpu"

    def next(self, **changes: Any) -> Self:
        """The same job with these changes, as its next version."""
        return self.model_copy(update={**changes, "version": self.version + 1})

    def become(self, wanted: JobStatus, **changes: Any) -> Self:
        """The same job in its next status; raises IllegalTransition."""
        if wanted not in NEXT[self.status]:
            raise IllegalTransition(self.id, self.status, wanted)
        return self.next(status=wanted, **changes)

    @staticmethod
    def token_of(number: int, secret: str) -> str:
        """The token of an attempt. secret: known only to the claimant, and different for each claim."""
        return f"{number}-{secret}"

    def claimed(
        self,
        worker: str,
        now: datetime,
        secret: str = "",
        details: Mapping[str, Any] | None = None,
        gpu_part: float | None = None,
    ) -> Self:
        """The job as starting, with a new attempt; without a secret, a fresh one is made."""
        token = self.token_of(self.next_attempt, secret or secrets.token_hex(8))
        attempt = Attempt(
            number=self.next_attempt,
            token=token,
            worker=worker,
            gpu_part=gpu_part,
            details=dict(details or {}),
            started_at=now,
        )
        return self.become(
            JobStatus.STARTING,
            attempts=(*self.attempts, attempt),
            started_at=self.started_at or now,
            not_before=None,
        )

    def running(self, **details: Any) -> Self:
        """The job as running, with facts about the attempt (device, engine, details)."""
        attempt = self.attempts[-1].model_copy(update=details)
        return self.become(JobStatus.RUNNING, attempts=(*self.attempts[:-1], attempt))

    def noted(self, **details: Any) -> Self:
        """The job with the same status, and with facts about the attempt."""
        attempt = self.attempts[-1].model_copy(update=details)
        return self.next(attempts=(*self.attempts[:-1], attempt))

    def ended(self, status: JobStatus, reason: Reason, message: str, now: datetime) -> Self:
        """The job in a final status; its open attempt is closed with the same reason."""
        return self.become(
            status,
            reason=reason,
            message=message,
            finished_at=now,
            not_before=None,
            attempts=self._closed(reason, message, now),
        )

    def requeued(
        self, reason: Reason, message: str, now: datetime, *, not_before: datetime | None = None
    ) -> Self:
        """The job, queued again; its attempt is closed."""
        closed = self._closed(reason, message, now)
        return self.become(JobStatus.QUEUED, attempts=closed, not_before=not_before)

    def with_artifacts(self, artifacts: tuple[Artifact, ...]) -> Self:
        """The job with these files; one of the same name replaces the older."""
        named = {artifact.name: artifact for artifact in (*self.artifacts, *artifacts)}
        return self.next(artifacts=tuple(named.values()))

    def without_artifacts(self, artifacts: Collection[Artifact]) -> Self:
        """The job without these files."""
        gone = {artifact.key for artifact in artifacts}
        return self.next(artifacts=tuple(found for found in self.artifacts if found.key not in gone))

    def with_newest_checkpoints(self, keep: int, promised: Collection[int] = ()) -> Self:
        """The same version, without checkpoints older than the newest `keep`; `promised` steps stay."""
        steps = sorted({a.step or 0 for a in self.artifacts if a.role == "checkpoint"})[-keep:]
        wanted = {*steps, *promised}
        kept = tuple(a for a in self.artifacts if a.role != "checkpoint" or (a.step or 0) in wanted)
        return self.model_copy(update={"artifacts": kept})

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds that it trains side by side; empty for one that trains a single seed, or none."""
        return tuple(self.spec.seeds or ()) if isinstance(self.spec, TrainSpec) else ()

    def files_of(self, seed: int | None) -> list[Artifact]:
        """The files that belong to a seed, by default the first, and those that all seeds share."""
        if not self.seeds:
            return list(self.artifacts)
        wanted = self.seeds[0] if seed is None else seed
        return [a for a in self.artifacts if a.metadata.get("seed") in (None, wanted)]

    def newest(self, role: ArtifactRole, step: int | None = None, seed: int | None = None) -> Artifact | None:
        """The artifact of this role with the highest step, or of exactly this step; seed: as `files_of`."""
        found = [a for a in self.files_of(seed) if a.role == role and step in (None, a.step)]
        return max(found, key=lambda a: -1 if a.step is None else a.step, default=None)

    def _closed(self, reason: Reason, message: str, now: datetime) -> tuple[Attempt, ...]:
        if not self.attempts or self.attempts[-1].ended_at is not None:
            return self.attempts
        last = self.attempts[-1].model_copy(update={"ended_at": now, "reason": reason, "message": message})
        return (*self.attempts[:-1], last)
