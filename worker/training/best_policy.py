"""The policy of a training's best evaluation, which is kept beside the last one."""

from collections.abc import Callable

from core.algorithms.events import Evaluated
from worker.protocol import BestSoFar
from worker.training.event_writer import EventWriter
from worker.training.exports import ExportWriter

# The metric by which evaluations are compared.
RETURN = "eval/episode_reward"


class BestPolicy:
    """Keeps `policy-best`, and replaces it after each better evaluation of the job, over all its attempts.

    Of equal returns the first counts: an attempt that repeats steps of the one before changes nothing.
    before: the best one of the attempts before.
    """

    def __init__(self, events: EventWriter, before: BestSoFar | None) -> None:
        self._events = events
        self._return = float("-inf") if before is None else before.episode_return
        self._step = 0 if before is None else before.step
        self._content = None if before is None else (events.spool / before.path).read_bytes()

    def see(self, evaluated: Evaluated, policy: Callable[[], bytes]) -> None:
        """Keep the policy if its evaluation is the best so far. policy: writes the one that was evaluated."""
        found = evaluated.metrics.get(RETURN)
        if found is None or not found > self._return:
            return
        self._return, self._step, self._content = found, evaluated.step, policy()
        self._events.keep(
            "policy-best",
            self._content,
            "best_policy",
            "application/octet-stream",
            step=self._step,
            metadata={"return": found},
        )

    def keep_exports(self, exports: ExportWriter) -> None:
        """Keep it for programs elsewhere, too, when the training ends."""
        if self._content is not None:
            exports.keep_best(self._content, self._step)
