"""The part of the record for sweeps."""

from collections.abc import Collection, Mapping, Sequence

from core.adapters.cursors import check_cursor
from core.adapters.postgres import sweeps
from core.adapters.postgres.connected import Connected
from core.jobs.job import Job, UnreadableJob
from core.jobs.store import Idempotency
from core.sweeps.store import SweepMark, SweepPage
from core.sweeps.sweep import Sweep, SweepStatus, Trial


class PostgresSweeps(Connected):
    """What a SweepStore has besides a JobStore."""

    def add_sweep(
        self, sweep: Sweep, idempotency: Idempotency | None = None, *, most_active: int | None = None
    ) -> Sweep:
        with self._transaction() as connection:
            return sweeps.add(connection, sweep, idempotency, most_active)

    def num_active_sweeps(self) -> int:
        with self._statements() as connection:
            return sweeps.num_active(connection)

    def get_sweep(self, sweep_id: str) -> Sweep:
        with self._statements() as connection:
            return sweeps.get(connection, sweep_id)

    def save_sweep(self, sweep: Sweep) -> None:
        with self._statements() as connection:
            sweeps.save(connection, sweep)

    def delete_sweep(self, sweep_id: str, version: int) -> None:
        with self._statements() as connection:
            sweeps.remove(connection, sweep_id, version)

    def list_sweeps(
        self, *, status: SweepStatus | None = None, cursor: str | None = None, limit: int = 50
    ) -> SweepPage:
        before = None if cursor is None else check_cursor(cursor)
        with self._statements() as connection:
            found, has_more = sweeps.newest(connection, status, before, limit)
        return SweepPage(found, found[-1].id if has_more else None)

    def active_marks(self) -> Mapping[str, SweepMark]:
        with self._statements() as connection:
            return sweeps.active_marks(connection)

    def active_sweeps(self, among: Collection[str] | None = None) -> Sequence[Sweep]:
        with self._statements() as connection:
            return sweeps.active(connection, among)

    def trials(self, sweep_ids: Collection[str]) -> Mapping[str, Sequence[Trial]]:
        if not sweep_ids:
            return {}
        with self._statements() as connection:
            return sweeps.trials_of(connection, sweep_ids)

    def jobs_of(self, job_ids: Collection[str]) -> Mapping[str, Job | UnreadableJob]:
        if not job_ids:
            return {}
        with self._statements() as connection:
            return sweeps.jobs_of(connection, job_ids)

    def add_trial(self, sweep_id: str, trial: Trial, job: Job | None) -> bool:
        with self._transaction() as connection:
            return sweeps.add_trial(connection, sweep_id, trial, job)

    def save_trial(self, sweep_id: str, trial: Trial) -> bool:
        with self._statements() as connection:
            return sweeps.save_trial(connection, sweep_id, trial)
