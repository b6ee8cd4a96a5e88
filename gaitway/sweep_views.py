"""What the client returns of sweeps. Unknown members are ignored: a newer service may send more."""

from datetime import datetime
from typing import Any

from pydantic import Field

from gaitway.views import FINAL_STATUSES, View


class TrialView(View):
    """One setting of a sweep, and the job that tries it.

    values: of the objectives, in their order. By `pbt`: generation, the first is 0; parent, the number of the
    trial from whose checkpoint it resumed.
    """

    number: int
    job: str | None = None
    status: str
    message: str | None = None
    parameters: dict[str, Any] = Field(default_factory=dict[str, Any])
    values: tuple[float | None, ...] = ()
    step: int = 0
    generation: int | None = None
    parent: int | None = None
    gpu_hours: float = 0.0
    created_at: datetime | None = None
    finished_at: datetime | None = None


class GroupView(View):
    """The seeds of one setting together. spread: the standard deviation."""

    parameters: dict[str, Any] = Field(default_factory=dict[str, Any])
    trials: tuple[int, ...] = ()
    mean: tuple[float | None, ...] = ()
    spread: tuple[float | None, ...] = ()


class SweepView(View):
    """A sweep as it was when it was read; trials, groups and importance only where it was read alone.

    best: the best trial so far; with several objectives, all that no other one beats in every one.
    """

    id: str
    name: str | None = None
    labels: dict[str, str] = Field(default_factory=dict[str, str])
    status: str
    message: str | None = None
    created_at: datetime
    finished_at: datetime | None = None
    spec: dict[str, Any] = Field(default_factory=dict[str, Any])
    num_trials: dict[str, int] = Field(default_factory=dict[str, int])
    max_trials: int = 0
    best: tuple[TrialView, ...] = ()
    trials: tuple[TrialView, ...] = ()
    groups: tuple[GroupView, ...] = ()
    importance: dict[str, dict[str, float]] | None = None
    importance_note: str | None = None
    links: dict[str, Any] = Field(default_factory=dict[str, Any])

    @property
    def is_final(self) -> bool:
        """Whether the sweep has ended."""
        return self.status in FINAL_STATUSES

    @property
    def metrics(self) -> list[str]:
        """The objectives' metrics."""
        return [str(one.get("metric", "")) for one in self._objectives]

    @property
    def is_minimized(self) -> bool:
        """Whether less is better, by the first objective."""
        return any(one.get("direction") == "minimize" for one in self._objectives[:1])

    @property
    def _objectives(self) -> list[dict[str, Any]]:
        said: Any = self.spec.get("objective", {})
        return said if isinstance(said, list) else [said]  # pyright: ignore[reportUnknownVariableType]

    def __repr__(self) -> str:
        told = ", ".join(f"{number} {status}" for status, number in self.num_trials.items())
        return f"<Sweep {self.id} {self.status}: {told or 'no trial yet'}>"

    __str__ = __repr__
