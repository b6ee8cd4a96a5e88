"""The course of a run, whatever is learnt in it: epochs that follow the clock, and what is due between."""

import math
import time
from collections.abc import Callable, Iterator, Mapping

from core.algorithms.events import CheckpointReady, Evaluated, Event, Phase, Progress
from core.algorithms.schedule import Schedule
from core.errors import JobFailed


class Loop:
    """Counts a run's updates, and says what comes when.

    epoch_s: seconds that an epoch aims at; it changes how often Progress comes, and nothing else.
    """

    def __init__(self, schedule: Schedule, epoch_s: float) -> None:
        self.updates = 0
        self._evaluated = 0
        self._schedule = schedule
        self._epoch_s = epoch_s
        self._training_s = self._evaluation_s = 0.0

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
        """What a checkpoint keeps of this."""
        return {"step": self.step, "updates": self.updates, "evaluated": self._evaluated}

    def resume(self, progress: Mapping[str, int]) -> None:
        """Go on from what a checkpoint kept."""
        self.updates, self._evaluated = progress["updates"], progress["evaluated"]

    def events(
        self, train: Callable[[int], Mapping[str, float]], evaluate: Callable[[], dict[str, float]]
    ) -> Iterator[Event]:
        """For each epoch Progress, and at their updates Evaluated and CheckpointReady, the last of each at
        the end. Phase first_update comes before the first Progress.

        train: until so many updates are made, or a value is not finite; it notes them in `updates`, and
        returns the epoch's metrics. evaluate: metrics of the present state. Raises JobFailed("diverged")
        where these are not finite.
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
        bad = [name for name, value in metrics.items() if not math.isfinite(value)]
        if bad:
            raise JobFailed(
                "diverged",
                f"The evaluation at environment step {self.step} gave a value that is not finite: {bad[0]}.",
                step=self.step,
                quantity=bad[0],
            )
        self._evaluated = self.updates
        yield Evaluated(self.step, metrics)
