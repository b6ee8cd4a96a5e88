"""Videos and replays of policies while they are trained."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from core.algorithms.trained_policy import TrainedPolicy, load_policy
from core.environments.rollout import Roller
from core.jobs.job import JobPhase
from core.jobs.spec import VideoSpec
from worker.training.built_environment import BuiltEnvironment
from worker.training.exports import PolicyInTraining, TimeBudget
from worker.training.video import ReplayWriter, VideoRecorder


@dataclass
class PolicyVideos:
    """Videos and replays of a training's policies as they are at the time.

    The first of them compiles what acts by a policy; the others share it.
    """

    video: VideoSpec
    built: BuiltEnvironment
    policies: Sequence[PolicyInTraining]
    _films: dict[int | None, VideoRecorder] = field(default_factory=dict[int | None, VideoRecorder])
    _budget: TimeBudget = field(default_factory=TimeBudget)

    def at_checkpoint(self, step: int, enter: Callable[[JobPhase], None], *, is_last: bool) -> None:
        """Keep videos, where the job asks for them; otherwise replays, where that costs next to nothing.

        enter: tells what the process does from now on. is_last: whether the training ends with this step. A
        seed that has diverged has none.
        """
        trained = [policy for policy in self.policies if policy.step() == step]
        if self.video.every_checkpoint:
            enter("drawing")
            self._take(f"video-{step:012d}", trained)
            enter("training")
        elif not is_last and self._budget.allows_another():
            began = time.monotonic()
            enter("drawing")
            for policy in trained:
                film, parameters = self._filmed(policy)
                film.replay(f"-{step:012d}", parameters, step)
            self._budget.spent(began)
            enter("training")

    def take(self, name: str) -> None:
        """Keep a video of each policy as `<name>.mp4`, with its present step."""
        self._take(name, self.policies)

    def _take(self, name: str, policies: Iterable[PolicyInTraining]) -> None:
        for policy in policies:
            film, parameters = self._filmed(policy)
            film.shoot(name, parameters, policy.step())

    def _filmed(self, policy: PolicyInTraining) -> tuple[VideoRecorder, Any]:
        """The recorder, and the policy's parameters as they are now."""
        # Not from a checkpoint, which may hold a replay buffer.
        trained = load_policy(policy.content(), policy.spec.algorithm.algorithm(), is_checkpoint=False)
        if policy.seed not in self._films:
            self._films[policy.seed] = self._recorder(policy, trained)
        return self._films[policy.seed], trained.parameters

    def _recorder(self, policy: PolicyInTraining, trained: TrainedPolicy) -> VideoRecorder:
        if self._films:
            first = next(iter(self._films.values()))
            replays = ReplayWriter(first.built, policy.events)
            return replace(first, spec=policy.spec, events=policy.events, replays=replays)
        environment, act = trained.acting(self.built.environment)
        built = replace(self.built, environment=environment)
        roller = Roller(environment, act, num_envs=self.video.episodes)
        replays = ReplayWriter(built, policy.events)
        return VideoRecorder(policy.spec, self.video, built, roller, policy.events, replays)
