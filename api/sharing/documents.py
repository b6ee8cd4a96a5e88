"""The documents in an export, as they are read: another version may have written them, or anybody else.

Every field that is kept has a bound; unknown ones are ignored.
"""

from datetime import UTC, datetime
from sys import float_info
from typing import Annotated

from pydantic import AwareDatetime, Field, StringConstraints

from api.sharing.export import FORMAT
from core.bounds import (
    LONGEST_MESSAGE,
    LONGEST_NAME,
    MOST_ATTEMPTS,
    MOST_FILES,
    MOST_IN_A_ROW,
    Facts,
    JobDocument,
    PastStep,
)
from core.documents import Stored
from core.jobs.job import ArtifactRole
from core.jobs.spec import JobId
from core.jobs.status import JobStatus
from core.reasons import Reason

# Times that PostgreSQL stores and Python reads.
Moment = Annotated[
    AwareDatetime, Field(ge=datetime(1970, 1, 1, tzinfo=UTC), lt=datetime(3000, 1, 1, tzinfo=UTC))
]
Name = Annotated[str, StringConstraints(max_length=LONGEST_NAME)]
Message = Annotated[str, StringConstraints(max_length=LONGEST_MESSAGE)]
Size = Annotated[int, Field(ge=0, le=2**60)]
# Any number but those that are not finite.
Number = Annotated[float, Field(ge=-float_info.max, le=float_info.max)]
Metrics = Annotated[dict[Name, Number | None], Field(max_length=MOST_IN_A_ROW)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Format(Stored):
    format: Annotated[int, Field(ge=0, le=10**9)] = FORMAT


class ExportedFile(Stored):
    path: Annotated[str, Field(max_length=2 * LONGEST_NAME)]
    sha256: Sha256
    size: Size


class Contents(Stored):
    files: Annotated[tuple[ExportedFile, ...], Field(max_length=MOST_FILES)]


class Package(Stored):
    gaitway: Annotated[str, Field(max_length=100)]


class Versions(Stored):
    service: Package


class ExportedArtifact(Stored):
    name: Annotated[str, Field(pattern=r"^[^/\\]+$", max_length=200)]
    role: ArtifactRole
    # It becomes a header of answers.
    media_type: Annotated[str, Field(pattern=r"^[A-Za-z0-9.+-]+/[A-Za-z0-9.+-]+$", max_length=100)]
    size: Size
    sha256: Sha256
    step: PastStep | None = None
    metadata: Facts = {}


class ExportedAttempt(Stored):
    number: Annotated[int, Field(ge=1, le=MOST_ATTEMPTS)]
    worker: Name
    device: Name | None = None
    engine: Name | None = None
    details: Facts = {}
    started_at: Moment
    ended_at: Moment | None = None
    reason: Reason | None = None
    message: Message | None = None


class ExportedProgress(Stored):
    step: PastStep = 0
    total: PastStep = 0
    steps_per_second: Number | None = None
    eta_s: Number | None = None
    # Null where one was not finite.
    metrics: Metrics = {}


class Record(Stored):
    """`job.json`: a JobView."""

    id: JobId
    spec: JobDocument
    status: JobStatus
    reason: Reason | None = None
    message: Message | None = None
    created_at: Moment
    started_at: Moment | None = None
    finished_at: Moment | None = None
    progress: ExportedProgress = ExportedProgress()
    attempts: Annotated[tuple[ExportedAttempt, ...], Field(max_length=MOST_ATTEMPTS)] = ()
    artifacts: Annotated[tuple[ExportedArtifact, ...], Field(max_length=MOST_FILES)] = ()


class Row(Stored):
    """A line of `metrics.jsonl`."""

    step: PastStep
    time: Moment
    values: Metrics
