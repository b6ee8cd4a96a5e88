"""When something is due: a function of the settings alone, never of the clock, so that every run agrees."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Schedule:
    """After which of a run's `num_updates` updates an evaluation or a checkpoint is due.

    num_evals: evaluations spread evenly, the last at the end. checkpoint_every_steps: environment steps
    between checkpoints, each at the first update that reaches its multiple; None: only at the end.
    """

    num_updates: int
    steps_per_update: int
    num_evals: int
    checkpoint_every_steps: int | None

    def evaluation_due(self, update: int) -> bool:
        """Whether the policy is evaluated after this many updates."""
        return self._evaluations(update) > self._evaluations(update - 1)

    def checkpoint_due(self, update: int) -> bool:
        """Whether a checkpoint is made after this many updates."""
        return update >= self.num_updates or self._checkpoints(update) > self._checkpoints(update - 1)

    def next_stop(self, update: int) -> int:
        """The first update after this one at which something is due."""
        stop = self.num_updates
        if self.num_evals:
            stop = min(stop, -(-(self._evaluations(update) + 1) * self.num_updates // self.num_evals))
        if self.checkpoint_every_steps is not None:
            step = (self._checkpoints(update) + 1) * self.checkpoint_every_steps
            stop = min(stop, -(-step // self.steps_per_update))
        return stop

    def _evaluations(self, update: int) -> int:
        return update * self.num_evals // self.num_updates

    def _checkpoints(self, update: int) -> int:
        return (
            update * self.steps_per_update // self.checkpoint_every_steps
            if self.checkpoint_every_steps
            else 0
        )
