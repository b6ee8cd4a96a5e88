"""The events that a run yields to its caller: see `core.algorithms.run.Run`."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Phase:
    """A part of the start-up is over: `trace`, `compile`, `first_update`; it took `seconds`."""

    name: str
    seconds: float


@dataclass(frozen=True)
class Progress:
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


Event = Phase | Progress | Evaluating | Evaluated | CheckpointReady
