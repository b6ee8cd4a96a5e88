"""The events that a run yields to its caller: see `core.algorithms.run.Run`, and `SeedsRun` for the last."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field


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


@dataclass(frozen=True)
class SeedDiverged:
    """The values of one of several seeds became non-finite at `step`; the others continue.

    quantity: the first that was not finite. detail: a sentence, with the step of the last good state.
    """

    seed: int
    step: int
    quantity: str
    detail: str


Event = Phase | Progress | Evaluating | Evaluated | CheckpointReady | SeedDiverged
