"""The records of a sweep and of its trials, as immutable values."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from typing import Any, Literal, Self

from pydantic import Field, JsonValue

from core.documents import Stored
from core.sweeps.spec import SweepSpec

# The values of the objective by environment step.
Curve = Mapping[int, float]


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


# How a trial ended. refused: its values do not fit each other, so it never became a job. deleted: its job was
# deleted before its end was seen.
Outcome = Literal["succeeded", "failed", "cancelled", "pruned", "refused", "deleted"]


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

    def next(self, **changes: Any) -> Self:
        """The same sweep with these changes, as its next version."""
        return self.model_copy(update={**changes, "version": self.version + 1})
