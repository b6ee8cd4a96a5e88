"""What an algorithm offers to whoever runs it: a generator of events that the caller pulls.

The caller keeps control. Between two events it may store, stop (by not asking for more), or ask for
a checkpoint of the present state.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray


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
class Evaluated:
    """The policy of `step` was tried; metrics by Brax's names (`eval/...`)."""

    step: int
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class CheckpointReady:
    """The budget says to keep this `step`: ask the trainer for `checkpoint()` now."""

    step: int


Event = Phase | Progress | Evaluated | CheckpointReady


class Trainer(Protocol):
    """One run of one algorithm."""

    @property
    def step(self) -> int:
        """Environment steps taken so far, those before a resumption included."""
        ...

    @property
    def total(self) -> int:
        """Environment steps at the end of the run: the budget, rounded up to whole updates."""
        ...

    def events(self) -> Iterator[Event]:
        """Train to the end of the budget. Raises JobFailed("diverged", ...) on a value that is not finite."""
        ...

    def checkpoint(self) -> bytes:
        """The whole state of the run: equal states give equal bytes. Valid between two events."""
        ...

    def policy(self) -> bytes:
        """What inference needs, and nothing else, in the algorithm's own file format."""
        ...


@runtime_checkable
class ShowsTables(Protocol):
    """A trainer, some of whose state is of use to people: it is kept beside the policy, with its pictures."""

    def tables(self) -> Mapping[str, NDArray[Any]]:
        """Arrays by name, none of objects. Valid between two events.

        Drawn are `q_table` and `visits`, [states, actions] or [agents, states, actions]; `state_names`
        [states] and `action_names` [actions], of text, are written beside them. Others are only kept.
        """
        ...
