"""The documents in an export, as they are read: another version may have written them, or anybody else."""

from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import AwareDatetime, Field

from api.sharing.export import FORMAT
from core.documents import Stored
from core.jobs.job import ArtifactRole
from core.jobs.spec import JobId
from core.jobs.status import JobStatus
from core.reasons import Reason

# Times that PostgreSQL stores and Python reads.
Moment = Annotated[
    AwareDatetime, Field(ge=datetime(1970, 1, 1, tzinfo=UTC), lt=datetime(3000, 1, 1, tzinfo=UTC))
]
Step = Annotated[int, Field(ge=0, le=10**18)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Format(Stored):
    format: int = FORMAT


class ExportedFile(Stored):
    path: str
    sha256: Sha256
    size: Annotated[int, Field(ge=0)]


class Contents(Stored):
    files: tuple[ExportedFile, ...]


class Package(Stored):
    gaitway: Annotated[str, Field(max_length=100)]


class Versions(Stored):
    service: Package


class ExportedArtifact(Stored):
    name: Annotated[str, Field(pattern=r"^[^/\\]+$", max_length=200)]
    role: ArtifactRole
    # It becomes a header of answers.
    media_type: Annotated[str, Field(pattern=r"^[A-Za-z0-9.+-]+/[A-Za-z0-9.+-]+$", max_length=100)]
    size: int
    sha256: Sha256
    step: Step | None = None
    metadata: dict[str, Any] = {}


class ExportedAttempt(Stored):
    number: int
    worker: str
    device: str | None = None
    engine: str | None = None
    details: dict[str, Any] = {}
    started_at: Moment
    ended_at: Moment | None = None
    reason: Reason | None = None
    message: str | None = None


class ExportedProgress(Stored):
    step: Step = 0
    total: Step = 0
    steps_per_second: float | None = None
    eta_s: float | None = None
    # Null where one was not finite.
    metrics: dict[str, float | None] = {}


class Record(Stored):
    """`job.json`: a JobView."""

    id: JobId
    spec: dict[str, Any]
    status: JobStatus
    reason: Reason | None = None
    message: str | None = None
    created_at: Moment
    started_at: Moment | None = None
    finished_at: Moment | None = None
    progress: ExportedProgress = ExportedProgress()
    attempts: tuple[ExportedAttempt, ...] = ()
    artifacts: tuple[ExportedArtifact, ...] = ()


class Row(Stored):
    """A line of `metrics.jsonl`."""

    step: Step
    time: Moment
    values: dict[str, float | None]
