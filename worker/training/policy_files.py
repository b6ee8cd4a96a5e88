"""The files of the policies that a training makes."""

from collections.abc import Iterable, Sequence

from core.algorithms.events import Evaluated
from worker.protocol import BestSoFar
from worker.training.best_policy import BestPolicy
from worker.training.exports import ExportWriter
from worker.training.policy_in_training import PolicyInTraining


class PolicyFiles:
    """Keeps each policy as it was best, as it was at the newest checkpoint, and as it is at the end.

    before: the best evaluations' policies of the attempts before.
    """

    def __init__(
        self, policies: Sequence[PolicyInTraining], exports: ExportWriter, before: Iterable[BestSoFar]
    ) -> None:
        known = {one.seed: one for one in before}
        self._policies = policies
        self._exports = exports
        self._best = [BestPolicy(policy, known.get(policy.seed)) for policy in policies]

    def see(self, evaluated: Evaluated) -> None:
        """Keep those policies whose evaluation is the best so far."""
        for best in self._best:
            best.see(evaluated)

    def keep_newest(self) -> None:
        """Keep them for programs elsewhere, where that costs next to nothing."""
        self._exports.keep_newest(self._policies)

    def keep_best(self) -> None:
        """Keep the best ones for programs elsewhere, too, when the training ends."""
        for best in self._best:
            best.keep_exports(self._exports)

    def keep_last(self) -> None:
        """Keep the final policies."""
        for policy in self._policies:
            content = policy.content()
            self._exports.keep_last(policy, content)
            # After those: with this one the job has its final policy, in whatever form.
            policy.events.keep("policy", content, "policy", "application/octet-stream", step=policy.step())
