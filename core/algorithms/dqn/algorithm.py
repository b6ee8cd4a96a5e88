"""A deep Q-network: Q-learning where a table would have too many rows."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.checkpoint import describe
from core.algorithms.dqn.policy import FORMAT, write_policy
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.dqn.update import QUANTITIES, Hyperparameters, Learner, TrainingState
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.off_policy.metrics import training_metrics
from core.algorithms.q_learning.action_sets import make_action_set
from core.algorithms.sharding import ONE_DEVICE
from core.environments.environment import Environment
from core.environments.wrappers.action_repeat import repeat_action
from core.errors import Rejected


class DQN:
    """See `core.algorithms.algorithm.Algorithm`. The policy takes the best choice; see `policy.load`.

    devices: 1. Raises Rejected for several devices and settings without an action set;
    JobFailed("bad_model") where the environment lacks what that needs.
    """

    quantities = QUANTITIES
    format = FORMAT
    sharding = ONE_DEVICE
    split_fields = ()

    def __init__(self, environment: Environment, settings: DQNSpec, *, seed: int, devices: int = 1) -> None:
        settings.check_sharing(devices)
        if settings.action_set is None:
            raise Rejected("DQN needs an `action_set`.")
        action_set = make_action_set(settings.action_set, environment)
        self.settings = settings
        self.seed = jnp.uint32(seed)
        self.hyperparameters = Hyperparameters.of(settings)
        self.description = describe(environment, settings)
        self.header = self.description | {
            "num_parts": action_set.num_parts,
            "num_choices": action_set.num_choices,
            "epsilon": settings.epsilon.end,
        }
        self.env_steps_per_time_step = settings.num_envs * settings.action_repeat
        self._learner = Learner(repeat_action(environment, settings.action_repeat), action_set, settings)

    def init(self, seed: jax.Array) -> TrainingState:
        return self._learner.init(seed)

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        return self._learner.update(state, hyperparameters)

    def evaluated(self, state: TrainingState) -> tuple[Any, ...]:
        """(normaliser, network)."""
        return state.normalizer, state.params

    def evaluate(self, evaluated: tuple[Any, ...], key: jax.Array, update: jax.Array) -> EpisodeTotals:
        """Totals of episodes without exploration."""
        learner, settings = self._learner, self.settings
        normalizer, params = evaluated
        return run_episodes(
            learner.environment,
            learner.acting(params, normalizer),
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
        return write_policy(state.normalizer, state.params, self.header)

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        return {}
