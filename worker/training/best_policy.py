"""The policy of a training's best evaluation, which is kept beside the last one."""

from core.algorithms.events import Evaluated, metric_of_seed
from worker.protocol import BestSoFar
from worker.training.exports import ExportWriter
from worker.training.policy_in_training import PolicyInTraining

# The metric by which evaluations are compared.
RETURN = "eval/episode_reward"


class BestPolicy:
    """Keeps `policy-best`, and replaces it after each better evaluation of the job, over all its attempts.

    Of equal returns the first counts: an attempt that repeats steps of the one before changes nothing.
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
