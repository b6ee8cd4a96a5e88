"""Sweeps and their trials."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from pydantic import Field, JsonValue

from gaitway.schema.base import FINAL_STATUSES, SweepStatus, View


class TrialView(View):
    """One setting, and the job that tries it.

    status: its job's; or `pruned`, `refused` if its values did not fit each other, `deleted` if its job was.
    values: the objectives' last values, in their order; null where the job reported none. step: the steps
    that it took itself. By `pbt`: generation, the first is 0; parent, the number of the trial from whose
    checkpoint it resumed.
    """

    number: int = Field(examples=[0])
    job: str | None = Field(None, examples=["019aa3c2f0b1-5be0c1d2e3"])
    status: str = Field(examples=["succeeded"])
    message: str | None = None
    parameters: dict[str, JsonValue] = Field({}, examples=[{"algorithm.learning_rate": 3e-4, "seed": 1}])
    values: tuple[float | None, ...] = Field((), examples=[[2941.5]])
    step: int = 0
    generation: int | None = None
    parent: int | None = None
    gpu_hours: float = 0.0
    created_at: datetime
    finished_at: datetime | None = None


class GroupView(View):
    """The trials of one setting, which differ in their seeds alone.

    mean, spread (standard deviation): of each objective, over the trials that succeeded.
    """

    parameters: dict[str, JsonValue] = {}
    trials: tuple[int, ...] = ()
    mean: tuple[float | None, ...] = ()
    spread: tuple[float | None, ...] = ()


class SweepView(View):
    """A sweep as it is now.

    num_trials: by status, of those that began. max_trials: the most that its method or its budget allows.
    best: the best trial that succeeded; with several objectives, all that none beats in every one (the Pareto
    front).
    """

    id: str = Field(examples=["019aa3c2f0b1-5be0c1d2e3"])
    name: str | None = None
    labels: dict[str, str] = {}
    note: str | None = Field(None, description="Plain text about it, for people.")
    owner: str | None = Field(None, description="A user's name; null without accounts.")
    project: str = "default"
    status: SweepStatus
    message: str | None = Field(
        None, description="Why it ended, and how its trials did; while it runs, why its next trial waits."
    )
    created_at: datetime
    finished_at: datetime | None = None
    spec: dict[str, Any] = {}
    num_trials: dict[str, int] = Field({}, examples=[{"succeeded": 7, "running": 2}])
    max_trials: int = 0
    best: tuple[TrialView, ...] = ()
    links: dict[str, str] = {}

    @property
    def is_final(self) -> bool:
        """Whether the sweep has ended."""
        return self.status in FINAL_STATUSES

    @property
    def metrics(self) -> list[str]:
        """The objectives' metrics."""
        return [str(objective.get("metric", "")) for objective in self._objectives]

    @property
    def is_minimized(self) -> bool:
        """Whether less is better, by the first objective."""
        return any(objective.get("direction") == "minimize" for objective in self._objectives[:1])

    @property
    def _objectives(self) -> list[dict[str, Any]]:
        objective: Any = self.spec.get("objective", {})
        return objective if isinstance(objective, list) else [objective]  # pyright: ignore[reportUnknownVariableType]

    def __repr__(self) -> str:
        counts = ", ".join(f"{number} {status}" for status, number in self.num_trials.items())
        return f"<Sweep {self.id} {self.status}: {counts or 'no trial yet'}>"

    __str__ = __repr__


class SweepDetails(SweepView):
    """A sweep with its trials.

    groups: the seeds of each setting together; empty where `seed` is no axis. importance: by objective, the
    share of each axis in what makes trials differ (PED-ANOVA); null, and importance_note says why.
    """

    trials: tuple[TrialView, ...] = ()
    groups: tuple[GroupView, ...] = ()
    importance: Mapping[str, Mapping[str, float]] | None = None
    importance_note: str | None = None
