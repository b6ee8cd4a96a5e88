"""The seam to a cluster's scheduler, which starts, places and stops workers."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from core.jobs.slots import SlotKind

AllocationState = Literal["pending", "stuck", "running", "ending"]


class SchedulerAway(Exception):
    """The scheduler does not answer. What was asked of it may have happened, or may happen yet."""


class LaunchRefused(Exception):
    """The scheduler refuses, and says why: nothing was started."""


@dataclass(frozen=True)
class Allocation:
    """A worker that the scheduler was asked for. node: where it runs, once it does.

    state: one that is `stuck` has not begun, and will not soon: it is held, or waits after a requeue.
    reason: why it has not begun, in the scheduler's words.
    """

    id: str
    kind: SlotKind
    state: AllocationState
    node: str = ""
    reason: str = ""


class Launcher(Protocol):
    """Starts workers and ends those that have not begun. Each call ends within seconds."""

    def start(self, kind: SlotKind, number: int) -> None:
        """Ask for that many workers of a kind. Raises LaunchRefused, SchedulerAway; some may be started."""
        ...

    def what_runs(self) -> Sequence[Allocation]:
        """Every allocation of this service, whichever process asked for it. Raises SchedulerAway."""
        ...

    def stop(self, ids: Collection[str]) -> None:
        """Call off the allocations that are still pending; others go on. Raises SchedulerAway."""
        ...

    def explain(self, allocation: Allocation) -> str | None:
        """A sentence on an allocation that ended by itself before its worker had begun; None where the
        scheduler or a person ended it. A launcher that finds its node to blame starts nothing more there for
        a while, and says so."""
        ...
