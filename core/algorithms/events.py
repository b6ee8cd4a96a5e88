"""The events that a run yields to its caller: see `Run.events` and, for SeedDiverged, `SeedsRun.events`."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from core.algorithms.lost_body import LostBody, Steps


def metric_of_seed(seed: int, name: str) -> str:
    """The name of one seed's own value of a metric, in a run of several seeds."""
    return f"seed_{seed}/{name}"


def is_of_a_seed(name: str) -> bool:
    """Whether `metric_of_seed` gave this name."""
    return re.match(r"seed_\d+/", name) is not None


@dataclass(frozen=True)
class Phase:
    """A part of the start-up is over: `trace`, `compile`, `first_update`; it took `seconds`."""

    name: str
    seconds: float


@dataclass(frozen=True)
class TrainingProgress:
    """Training reached `step` of `total` environment steps; metrics by Brax's names (`training/...`)."""

    step: int
    total: int
    metrics: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class Evaluating:
    """The policy at `step` is evaluated next; the run's state is that of the event before."""

    step: int


@dataclass(frozen=True)
class Evaluated:
    """The policy at `step` was evaluated; metrics by Brax's names (`eval/...`)."""

    step: int
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class CheckpointReady:
    """A checkpoint of this `step` is due: ask the run for `checkpoint()` now."""

    step: int


@dataclass(frozen=True)
class SeedDiverged:
    """The values of one of several seeds became non-finite at `step`; the others continue.

    quantity: the first that was not finite. detail: a sentence, with the step of the last good state.
    """

    seed: int
    step: int
    quantity: str
    detail: str


@dataclass(frozen=True)
class BodyLost:
    """The run's first body whose state was lost, at environment step `step`; once in a run.

    env: its environment. steps: those of its episode in the same update, arrays [T, ...] on the host; the
    last one's action lost it. seed: in a run of several seeds.
    """

    step: int
    env: int
    steps: "Steps"
    seed: int | None = None

    @classmethod
    def of(cls, lost: "LostBody", per_update: int, per_time_step: int, seed: int | None = None) -> Self:
        """lost: on the host. per_update, per_time_step: environment steps."""
        step = int(lost.update) * per_update + int(lost.time_step) * per_time_step
        return cls(step, int(lost.env), lost.of_the_episode(), seed)


Event = Phase | TrainingProgress | Evaluating | Evaluated | CheckpointReady | SeedDiverged | BodyLost
