"""The files of the policies that a training makes: the last one, and that of its best evaluation."""

from collections.abc import Iterable, Sequence

from core.algorithms.events import Evaluated, metric_of_seed
from worker.protocol import BestSoFar
from worker.training.exports import ExportWriter, PolicyInTraining

# The metric by which evaluations are compared.
RETURN = "eval/episode_reward"


class BestPolicy:
    """Keeps `policy-best`, and replaces it after each better evaluation of the job, over all its attempts.

    The first of equal returns counts: an attempt that repeats steps of the one before changes nothing.
    before: the best one of the attempts before.
    """

    def __init__(self, policy: PolicyInTraining, before: BestSoFar | None) -> None:
        self._policy = policy
        self._metric = RETURN if policy.seed is None else metric_of_seed(policy.seed, RETURN)
        self._return = float("-inf") if before is None else before.episode_return
        self._step = 0 if before is None else before.step
        self._content = None if before is None else (policy.events.spool / before.path).read_bytes()

    def see(self, evaluated: Evaluated) -> None:
        """Keep the policy, which was just evaluated, if that is the best evaluation so far."""
        found = evaluated.metrics.get(self._metric)
        if found is None or not found > self._return:
            return
        self._return, self._step, self._content = found, evaluated.step, self._policy.content()
        self._policy.events.keep(
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
            exports.keep_best(self._policy, self._content, self._step)


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
