"""Soft actor-critic: few samples, for bodies whose physics is slow."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.checkpoint import describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.off_policy.metrics import training_metrics
from core.algorithms.sac.policy import FORMAT, write_policy
from core.algorithms.sac.spec import SACSpec
from core.algorithms.sac.update import QUANTITIES, Hyperparameters, Learner, TrainingState
from core.algorithms.sharding import ONE_DEVICE
from core.environments.environment import Environment
from core.environments.wrappers.action_repeat import repeat_action


class SAC:
    """See `core.algorithms.algorithm.Algorithm`. The policy is Brax's file of parameters. devices: 1."""

    quantities = QUANTITIES
    format = FORMAT
    sharding = ONE_DEVICE
    split_fields = ()

    def __init__(self, environment: Environment, settings: SACSpec, *, seed: int, devices: int = 1) -> None:
        settings.check_sharing(devices)
        self.settings = settings
        self.seed = jnp.uint32(seed)
        self.hyperparameters = Hyperparameters.of(settings)
        self.header = self.description = describe(environment, settings)
        self.env_steps_per_time_step = settings.num_envs * settings.action_repeat
        self._learner = Learner(repeat_action(environment, settings.action_repeat), settings)

    def init(self, seed: jax.Array) -> TrainingState:
        return self._learner.init(seed)

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        return self._learner.update(state, hyperparameters)

    def evaluated(self, state: TrainingState) -> tuple[Any, ...]:
        """(normaliser, policy)."""
        return state.normalizer, state.params.policy

    def evaluate(self, evaluated: tuple[Any, ...], key: jax.Array, update: jax.Array) -> EpisodeTotals:
        learner, settings = self._learner, self.settings
        normalizer, policy = evaluated
        return run_episodes(
            learner.environment,
            learner.networks.acting(
                policy, learner.normalize(normalizer), deterministic=settings.deterministic_eval
            ),
            jax.random.fold_in(key, update),
            num_envs=settings.num_eval_envs,
            episode_length=settings.actions_per_episode,
        )

    def training_metrics(
        self, state: TrainingState, sums: Mapping[str, Any], num_updates: int
    ) -> dict[str, float]:
        return training_metrics(sums, num_updates, self.settings.action_repeat)

    def after_evaluation(
        self, state: TrainingState, totals: EpisodeTotals
    ) -> tuple[TrainingState, dict[str, float]]:
        return state, evaluation_metrics(totals, self.settings.action_repeat)

    def policy(self, state: TrainingState) -> bytes:
        return write_policy(state.normalizer, state.params.policy, self.header)

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        return {}
