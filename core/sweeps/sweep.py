"""The records of a sweep and of its trials, as immutable values, and the store that keeps them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Literal, Protocol, Self

from pydantic import Field, JsonValue

from core.accounts.principal import DEFAULT_PROJECT, Ownership
from core.documents import Stored
from core.jobs.job import Job
from core.jobs.store import ANYBODYS, Idempotency, JobStore, Whose
from core.sweeps.spec import SweepSpec

# The values of the objective by environment step.
Curve = Mapping[int, float]
# How a trial ended. refused: its values do not fit each other, so it never became a job. deleted: its job was
# deleted before its end was seen.
Outcome = Literal["succeeded", "failed", "cancelled", "pruned", "refused", "deleted"]


class SweepStatus(StrEnum):
    """running → succeeded | failed; running → cancelling → cancelled; a resumed one is running again."""

    RUNNING = "running"
    CANCELLING = "cancelling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def is_final(self) -> bool:
        return self not in (SweepStatus.RUNNING, SweepStatus.CANCELLING)


class Trial(Stored):
    """One setting of a sweep, and the job that tries it.

    number: 0, 1, 2, … within the sweep. planned_steps: the environment steps that it may take. outcome: None
    until it has ended. values: of the objectives, in their order, None where the job reported none.
    is_pruned: decided; its job may still be saving its work. gpu_hours: of all attempts.
    parent: the number of the trial from whose checkpoint it resumes. inherited_steps: the steps of that
    checkpoint's run; `steps` and `planned_steps` count the trial's own.
    """

    number: int
    job: str | None
    parameters: dict[str, JsonValue]
    planned_steps: int = 0
    parent: int | None = None
    inherited_steps: int = 0
    is_pruned: bool = False
    outcome: Outcome | None = None
    message: str | None = None
    values: tuple[float | None, ...] = ()
    steps: int = 0
    gpu_hours: float = 0.0
    created_at: datetime
    finished_at: datetime | None = None

    @property
    def has_values(self) -> bool:
        """Whether it can be compared: it has a value for every objective."""
        return bool(self.values) and None not in self.values


@dataclass(frozen=True)
class SeenTrial:
    """A trial as it is now. curve: the objective's values by step, read only for pruning."""

    trial: Trial
    curve: Curve = field(default_factory=dict[int, float])

    @property
    def is_over(self) -> bool:
        return self.trial.outcome is not None


class Sweep(Stored):
    """The record. `version` rises by one with every step; the store refuses any other.

    message: why it ended; while it runs, for which room its next trial waits, if it does.
    importance: by objective, the share of each axis in what makes trials differ; importance_note: why there
    is none. num_judged: the number of trials with values from which it was computed.
    """

    id: str
    version: int = 1
    spec: SweepSpec
    status: SweepStatus = SweepStatus.RUNNING
    message: str | None = None
    created_at: datetime
    finished_at: datetime | None = None
    importance: Mapping[str, Mapping[str, float]] | None = None
    importance_note: str | None = None
    num_judged: int = Field(default=0, ge=0)
    owner: str | None = None
    project: str = DEFAULT_PROJECT

    @property
    def ownership(self) -> Ownership:
        """That of its trials' jobs, too."""
        return Ownership(self.owner, self.project)

    def next(self, **changes: Any) -> Self:
        """The same sweep with these changes, as its next version."""
        return self.model_copy(update={**changes, "version": self.version + 1})


@dataclass(frozen=True)
class SweepPage:
    """Some sweeps, newest first, and the cursor of the next page; None at the end."""

    sweeps: Sequence[Sweep]
    next_cursor: str | None


@dataclass(frozen=True)
class SweepMark:
    """The versions that decide about an active sweep: while this is equal, there is nothing new to do for it.

    going: the jobs of its trials that have not ended, and their versions. events: how many events these have.
    """

    version: int
    going: str | None
    events: str | None


class SweepStore(JobStore, Protocol):
    """The record of jobs with that of sweeps. Each write is one transaction."""

    def add_sweep(
        self, sweep: Sweep, idempotency: Idempotency | None = None, *, most_active: int | None = None
    ) -> Sweep:
        """Store a new sweep and return it; or, for a key seen before with the same fingerprint, the sweep
        stored then. Raises IdempotencyKeyReused; TooManySweeps if `most_active` are active; JobNotFound where
        the checkpoint of its job's source is gone. A key is remembered as long as its sweep exists."""
        ...

    def remembered_sweep(self, idempotency: Idempotency) -> Sweep | None:
        """The sweep that an earlier submission with this key created, if any. Raises IdempotencyKeyReused."""
        ...

    def num_active_sweeps(self) -> int:
        """How many have not ended."""
        ...

    def get_sweep(self, sweep_id: str) -> Sweep:
        """Raises SweepNotFound."""
        ...

    def owner_of_sweep(self, sweep_id: str) -> Ownership:
        """Raises SweepNotFound."""
        ...

    def save_sweep(self, sweep: Sweep) -> None:
        """Store the next version. Raises StaleSweep unless the stored version is the one before,
        SweepNotFound where there is none, and JobNotFound where an ended one begins to run again and the
        checkpoint of its job's source is gone."""
        ...

    def delete_sweep(self, sweep_id: str, version: int) -> None:
        """Delete the record of the sweep and its trials; its jobs stay. Raises SweepNotFound, StaleSweep."""
        ...

    def list_sweeps(
        self,
        *,
        ids: Collection[str] | None = None,
        status: SweepStatus | None = None,
        whose: Whose = ANYBODYS,
        cursor: str | None = None,
        limit: int = 50,
    ) -> SweepPage:
        """Newest first; after the own ones those of others, where `whose` says so. ids: only of these."""
        ...

    def sweeps_of(self, job_ids: Collection[str]) -> Mapping[str, str]:
        """The id of the sweep by the ids of those of these jobs that are trials."""
        ...

    def active_marks(self) -> Mapping[str, SweepMark]:
        """The marks of those that have not ended, oldest first."""
        ...

    def active_sweeps(self, among: Collection[str] | None = None) -> Sequence[Sweep]:
        """Those that have not ended, oldest first; one whose record this version cannot read is left out.

        among: only these; None: all.
        """
        ...

    def trials(self, sweep_ids: Collection[str]) -> Mapping[str, Sequence[Trial]]:
        """The trials of each of these sweeps, by their number; a sweep without trials is left out."""
        ...

    def add_trial(self, sweep_id: str, trial: Trial, job: Job | None) -> bool:
        """Store a trial with its job and the job's dispatch, all or nothing.

        False, and nothing changed, if the sweep has a trial of this number already or is not `running`. The
        statement waits for a cancel under way, so that none starts after one. Raises QuotaExceeded as
        `JobStore.add` does.
        """
        ...

    def save_trial(self, sweep_id: str, trial: Trial) -> bool:
        """Store what became of a trial; False, and nothing changed, if its outcome is stored already."""
        ...
