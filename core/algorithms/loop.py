"""The loop of a run, for any algorithm: epochs sized by the clock, and what is due between them."""

import math
import time
from collections.abc import Callable, Iterator, Mapping

from core.algorithms.algorithm import RunSettings
from core.algorithms.events import CheckpointReady, Evaluated, Evaluating, Event, Phase, Progress
from core.algorithms.schedule import Schedule
from core.errors import JobFailed
from core.reasons import Reason


class Loop:
    """Counts a run's updates, and decides what is due when.

    epoch_s: an epoch's target duration in seconds; it only changes how often Progress comes.
    """

    def __init__(self, schedule: Schedule, epoch_s: float) -> None:
        self.updates = 0
        self._evaluated = 0
        self._schedule = schedule
        self._epoch_s = epoch_s
        self._training_s = self._evaluation_s = 0.0

    @classmethod
    def of(cls, settings: RunSettings, checkpoint_every_steps: int | None, epoch_s: float) -> "Loop":
        """The loop of a run under these settings."""
        schedule = Schedule(
            settings.num_updates, settings.env_steps_per_update, settings.num_evals, checkpoint_every_steps
        )
        return cls(schedule, epoch_s)

    @property
    def step(self) -> int:
        """Environment steps taken so far, those before a resumption included."""
        return self.updates * self._schedule.steps_per_update

    @property
    def total(self) -> int:
        """Environment steps at the end: the budget, rounded up to whole updates."""
        return self._schedule.num_updates * self._schedule.steps_per_update

    @property
    def progress(self) -> dict[str, int]:
        """The counters that a checkpoint keeps."""
        return {"step": self.step, "updates": self.updates, "evaluated": self._evaluated}

    def resume(self, progress: Mapping[str, int]) -> None:
        """Continue from the counters that a checkpoint kept."""
        self.updates, self._evaluated = progress["updates"], progress["evaluated"]

    def events(
        self, train: Callable[[int], Mapping[str, float]], evaluate: Callable[[], dict[str, float]]
    ) -> Iterator[Event]:
        """Yields Progress for each epoch, and when due Evaluating, Evaluated and CheckpointReady; the last
        at the end in any case. Phase first_update precedes the first Progress.

        train: trains until the given number of updates is made or a value is not finite, records the number
        in `updates`, and returns the epoch's metrics. evaluate: the metrics of the current state.
        Raises JobFailed("diverged") if an evaluation's metric is not finite.
        """
        yield from self._evaluate_if_due(evaluate)  # a run may be stopped before an evaluation that was due
        if self.updates >= self._schedule.num_updates:
            yield CheckpointReady(self.step)
        until = self.updates + 1
        while self.updates < self._schedule.num_updates:
            before, first = self.updates, not self._training_s
            started = time.perf_counter()
            metrics = train(until)
            seconds, updates = time.perf_counter() - started, self.updates - before
            self._training_s += seconds
            if first:
                yield Phase("first_update", seconds)
            yield Progress(
                self.step,
                self.total,
                {
                    "training/sps": updates * self._schedule.steps_per_update / seconds,
                    "training/walltime": self._training_s,
                    **metrics,
                },
            )
            yield from self._evaluate_if_due(evaluate)
            if self._schedule.checkpoint_due(self.updates):
                yield CheckpointReady(self.step)
            affordable = max(1, round(self._epoch_s * updates / seconds))
            until = min(self.updates + affordable, self._schedule.next_stop(self.updates))

    def _evaluate_if_due(self, evaluate: Callable[[], dict[str, float]]) -> Iterator[Event]:
        if self._evaluated == self.updates or not self._schedule.evaluation_due(self.updates):
            return
        yield Evaluating(self.step)
        started = time.perf_counter()
        metrics = evaluate()
        seconds = time.perf_counter() - started
        self._evaluation_s += seconds
        share = self._evaluation_s / (self._evaluation_s + self._training_s)
        metrics |= {
            "eval/epoch_eval_time": seconds,
            "eval/walltime": self._evaluation_s,
            "eval/walltime_share": share,
        }
        check_finite(metrics, self.step)
        self._evaluated = self.updates
        yield Evaluated(self.step, metrics)


def check_finite(evaluated: Mapping[str, float], step: int) -> None:
    """Raises JobFailed("diverged") if a metric of the evaluation at this environment step is not finite."""
    bad = [name for name, value in evaluated.items() if not math.isfinite(value)]
    if bad:
        raise JobFailed(
            Reason.DIVERGED,
            f"The evaluation at environment step {step} gave a value that is not finite: {bad[0]}.",
            step=step,
            quantity=bad[0],
        )
