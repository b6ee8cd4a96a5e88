"""Carries out what `advance` decides. Idempotent, and safe to run in many places at once.

A trial's record, its job and the job's dispatch are one transaction, and a sweep has each number once:
however often a process dies, or however many look at the same time, a trial starts once.
"""

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import structlog
from pydantic import ValidationError

from core.algorithms.catalog import reported
from core.errors import (
    JobFinished,
    JobNotFound,
    JobUnreadable,
    QuotaExceeded,
    Rejected,
    StaleSweep,
    SweepNotFound,
    Unavailable,
)
from core.jobs import submission
from core.jobs.ending import cancel
from core.jobs.job import Job
from core.jobs.queue import JobQueue
from core.jobs.quotas import check_quotas
from core.jobs.spec import JobSpec, TrainSpec
from core.jobs.store import Dispatch
from core.storage.objects import ObjectStore
from core.sweeps.actions import readable_by
from core.sweeps.advance import CancelTrial, Decision, EndSweep, PruneTrial, StartTrial, advance
from core.sweeps.axes import job_of
from core.sweeps.checks import steps_of
from core.sweeps.pruning import ObjectiveCurves
from core.sweeps.results import importance, judged
from core.sweeps.sweep import SeenTrial, Sweep, SweepMark, SweepStore, Trial

log = structlog.get_logger()

# A sweep for which nothing changes is looked at again after so long: budgets of GPU hours pass with time.
_LOOK_ANYWAY_S = 60.0
# One whose next trial waits for room in a quota: others make that room.
_LOOK_FOR_ROOM_S = 5.0


@dataclass(frozen=True)
class _Settled:
    """A sweep that needed nothing at a moment, and its mark then. prunes: its trials' events decide, too.

    for_s: it is looked at again after so long.
    """

    mark: SweepMark
    prunes: bool
    at_s: float
    for_s: float

    def holds(self, mark: SweepMark) -> bool:
        """Whether it still needs nothing."""
        is_equal = mark == (self.mark if self.prunes else replace(self.mark, events=mark.events))
        return is_equal and time.monotonic() - self.at_s < self.for_s


class SweepController:
    """Moves all sweeps on; call `run_once` every second or two."""

    def __init__(self, store: SweepStore, queue: JobQueue, objects: ObjectStore) -> None:
        self._store = store
        self._queue = queue
        self._objects = objects
        # Both of active sweeps alone.
        self._curves: dict[str, ObjectiveCurves] = {}
        self._settled: dict[str, _Settled] = {}

    def run_once(self) -> int:
        """Returns the number of decisions. Raises RecordsUnavailable, StorageUnavailable.

        Reads only the sweeps for which something has changed since they needed nothing.
        """
        marks = self._store.active_marks()
        self._curves = {one: curves for one, curves in self._curves.items() if one in marks}
        self._settled = {one: settled for one, settled in self._settled.items() if one in marks}
        changed = [
            one
            for one, mark in marks.items()
            if (settled := self._settled.get(one)) is None or not settled.holds(mark)
        ]
        sweeps = self._store.active_sweeps(changed) if changed else ()
        trials = self._store.trials([sweep.id for sweep in sweeps])
        return sum(self._try_to_move_on(sweep, trials.get(sweep.id, ()), marks[sweep.id]) for sweep in sweeps)

    def _try_to_move_on(self, sweep: Sweep, trials: Sequence[Trial], mark: SweepMark) -> int:
        """One sweep that meets a bug must not stop the others, nor this process."""
        try:
            decided = self._move_on(sweep, trials)
        except Unavailable:
            raise
        except Exception:
            log.exception("sweep_stuck", sweep=sweep.id)
            return 0
        if not decided:
            # The message of a sweep that goes on says for which room its next trial waits.
            for_s = _LOOK_ANYWAY_S if sweep.message is None else _LOOK_FOR_ROOM_S
            prunes = sweep.spec.pruning is not None
            self._settled[sweep.id] = _Settled(mark, prunes, time.monotonic(), for_s)
        return decided

    def _move_on(self, sweep: Sweep, trials: Sequence[Trial]) -> int:
        seen = self._seen(sweep, self._judge(sweep, trials))
        with suppress(StaleSweep, SweepNotFound):  # Changed meanwhile: the next look sees how.
            sweep = self._with_importance(sweep, seen)
            decisions = advance(sweep, seen, lambda values: steps_of(sweep.spec, values, self._store))
            started, message, decided = list[Job](), None, 0
            try:
                for one in decisions:
                    if (job := self._carry_out(sweep, one)) is not None:
                        started.append(job)
                    decided += 1
            except QuotaExceeded as error:  # Starts come last, and those after this one wait with it.
                message = f"Its next trial waits for room. {error.detail}"
            # After all are stored: the worker that gets the first may train the others together with it.
            for job in started:
                self._hand_over(job)
            return decided + self._say_why_it_waits(sweep, decisions, message)
        return 0

    def _say_why_it_waits(self, sweep: Sweep, decisions: Sequence[Decision], message: str | None) -> bool:
        """Store the sentence, or that there is none any more; whether it has changed."""
        has_ended = any(isinstance(one, EndSweep) for one in decisions)
        if has_ended or message == sweep.message:
            return False
        self._store.save_sweep(sweep.next(message=message))
        return True

    def _judge(self, sweep: Sweep, trials: Sequence[Trial]) -> Sequence[Trial]:
        """The trials as their jobs are now; those that have ended are stored so."""
        going = [trial.job for trial in trials if trial.outcome is None and trial.job is not None]
        jobs, now = self._store.jobs_of(going), self._store.now()
        found = [judged(one, jobs.get(one.job or ""), sweep.spec.objectives, now) for one in trials]
        for before, after in zip(trials, found, strict=True):
            if before.outcome is None and after.outcome is not None:
                self._store.save_trial(sweep.id, after)
                log.info("trial_ended", sweep=sweep.id, trial=after.number, outcome=after.outcome)
        return found

    def _seen(self, sweep: Sweep, trials: Iterable[Trial]) -> Sequence[SeenTrial]:
        if sweep.spec.pruning is None:
            return [SeenTrial(trial) for trial in trials]
        metric = sweep.spec.objectives[0].metric
        curves = self._curves.setdefault(sweep.id, ObjectiveCurves(self._store, self._objects))
        return [
            SeenTrial(trial, curves.read(trial.job, metric, has_ended=trial.outcome is not None))
            for trial in trials
        ]

    def _with_importance(self, sweep: Sweep, seen: Sequence[SeenTrial]) -> Sweep:
        """The sweep with the importance of its axes, computed when another trial has succeeded."""
        number = sum(one.trial.outcome == "succeeded" and one.trial.has_values for one in seen)
        if number == sweep.num_judged:
            return sweep
        shares, note = importance(sweep.spec, seen)
        changed = sweep.next(importance=shares, importance_note=note, num_judged=number)
        self._store.save_sweep(changed)
        return changed

    def _carry_out(self, sweep: Sweep, decision: Decision) -> Job | None:
        """Returns the job of a trial that was started."""
        match decision:
            case StartTrial():
                return self._start(sweep, decision)
            case PruneTrial(trial=trial):
                if self._store.save_trial(sweep.id, trial.model_copy(update={"is_pruned": True})):
                    log.info("trial_pruned", sweep=sweep.id, trial=trial.number)
                    self._cancel(trial)
            case CancelTrial(trial=trial):
                self._cancel(trial)
            case EndSweep(status=status, message=message):
                ended = {"status": status, "message": message, "finished_at": self._store.now()}
                self._store.save_sweep(sweep.next(**ended))
                log.info("sweep_ended", sweep=sweep.id, status=status)
        return None

    def _start(self, sweep: Sweep, start: StartTrial) -> Job | None:
        """Store the trial with its job, and return that; or, where its values do not fit, as refused.

        Raises QuotaExceeded.
        """
        trial = Trial(
            number=start.number,
            job=None,
            parameters=start.parameters,
            planned_steps=start.planned_steps,
            parent=start.parent,
            inherited_steps=start.inherited_steps,
            created_at=self._store.now(),
        )
        try:
            spec = job_of(sweep.spec.job, {**start.parameters, **start.settings})
            if start.parent is not None:
                spec = self._like_its_source(spec)
            spec = spec.model_copy(update={"labels": labels_of(sweep, start.number, spec.labels)})
            readable = readable_by(sweep.ownership)
            check_quotas(spec, sweep.ownership, self._store)
            job = submission.new_job(spec, self._store, sweep.ownership, readable, correlation_id=sweep.id)
        except (ValidationError, Rejected) as error:
            refused = {"outcome": "refused", "message": _sentence(error), "finished_at": trial.created_at}
            self._store.add_trial(sweep.id, trial.model_copy(update=refused), None)
            return None
        if not self._store.add_trial(sweep.id, trial.model_copy(update={"job": job.id}), job):
            return None
        log.info("trial_started", sweep=sweep.id, trial=trial.number, job_id=job.id)
        return job

    def _hand_over(self, job: Job) -> None:
        dispatch = Dispatch("attempt", job.id, job.next_attempt)
        if submission.hand_over_if_room(dispatch, job, self._queue):
            self._store.dispatched([dispatch])

    def _like_its_source(self, spec: JobSpec) -> JobSpec:
        """The job with the hyperparameters that the job it resumes from had, where it says none itself.

        Another device or a later version may have other tuned values, which would not fit the checkpoint.
        """
        if not isinstance(spec, TrainSpec) or spec.source is None:
            return spec
        source = self._store.jobs_of([spec.source.job]).get(spec.source.job)
        if not isinstance(source, Job) or source.begun is None:
            return spec
        had = source.begun.details.get("hyperparameters")
        if had is None:
            return spec
        own = {name: getattr(spec.algorithm, name) for name in spec.algorithm.model_fields_set}
        return spec.model_copy(update={"algorithm": reported(had).model_copy(update=own)})

    def _cancel(self, trial: Trial) -> None:
        if trial.job is not None:
            with suppress(JobFinished, JobNotFound, JobUnreadable):
                cancel(trial.job, store=self._store, queue=self._queue)


def labels_of(sweep: Sweep, number: int, own: Mapping[str, str]) -> dict[str, str]:
    """The labels of a trial's job: its own, the sweep's, and which trial of which sweep it is."""
    return {**own, **sweep.spec.labels, "sweep": sweep.id, "trial": str(number)}


def _sentence(error: ValidationError | Rejected) -> str:
    if isinstance(error, Rejected):
        return error.detail
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}."
