"""The record's part for sweeps."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from core.jobs.job import Job
from core.jobs.store import Idempotency, JobStore
from core.sweeps.sweep import Sweep, SweepStatus, Trial


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
        stored then. Raises IdempotencyKeyReused; TooManySweeps if `most_active` are active. A key is
        remembered as long as its sweep exists."""
        ...

    def num_active_sweeps(self) -> int:
        """How many have not ended."""
        ...

    def get_sweep(self, sweep_id: str) -> Sweep:
        """Raises SweepNotFound."""
        ...

    def save_sweep(self, sweep: Sweep) -> None:
        """Store the next version. Raises StaleSweep unless the stored version is the one before, and
        SweepNotFound where there is none."""
        ...

    def delete_sweep(self, sweep_id: str, version: int) -> None:
        """Delete the record of the sweep and its trials; its jobs stay. Raises SweepNotFound, StaleSweep."""
        ...

    def list_sweeps(
        self, *, status: SweepStatus | None = None, cursor: str | None = None, limit: int = 50
    ) -> SweepPage:
        """Newest first."""
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
        statement waits for a cancel under way, so that none starts after one.
        """
        ...

    def save_trial(self, sweep_id: str, trial: Trial) -> bool:
        """Store what became of a trial; False, and nothing changed, if its outcome is stored already."""
        ...
