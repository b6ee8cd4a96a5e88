"""PPO (Schulman et al., 2017): Brax's networks, loss, normaliser and distributions in a loop of our own."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import make_inference_fn
from core.algorithms.checkpoint import describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.policy_file import PolicyConfig, PolicyParams, write_policy
from core.algorithms.ppo.checkpoint import FORMAT, header
from core.algorithms.ppo.hyperparameters import Hyperparameters
from core.algorithms.ppo.networks import make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.ppo.update import QUANTITIES, Learner, TrainingState
from core.algorithms.sharding import Sharding
from core.environments.environment import Environment
from core.environments.wrappers.action_repeat import repeat_action


class PPO:
    """See `core.algorithms.algorithm.Algorithm`. The policy is Brax's file of parameters.

    devices: how many share environments and each minibatch in equal parts. Raises Rejected if they cannot.
    """

    quantities = QUANTITIES
    format = FORMAT
    split_fields = ("episodes",)

    def __init__(self, environment: Environment, settings: PPOSpec, *, seed: int, devices: int = 1) -> None:
        self.settings = settings
        self.seed = jnp.uint32(seed)
        self.hyperparameters = Hyperparameters.of(settings)
        self.sharding = Sharding.over(devices, settings)
        self.description = describe(environment, settings)
        self.header = header(self.description)
        self.env_steps_per_time_step = settings.num_envs * settings.action_repeat
        self._learner = Learner(repeat_action(environment, settings.action_repeat), settings, self.sharding)

    def init(self, seed: jax.Array) -> TrainingState:
        return self._learner.init(seed)

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        return self._learner.update(state, hyperparameters)

    def evaluated(self, state: TrainingState) -> tuple[Any, ...]:
        """(normaliser, policy, value)."""
        return state.normalizer, state.params.policy, state.params.value

    def evaluate(self, evaluated: tuple[Any, ...], key: jax.Array, update: jax.Array) -> EpisodeTotals:
        environment, settings = self._learner.environment, self.settings
        networks = make_networks(
            environment.observation_size,
            environment.action_size,
            settings,
            normalize=settings.normalize_observations,
        )
        return run_episodes(
            environment,
            make_inference_fn(networks)(evaluated, deterministic=settings.deterministic_eval),
            jax.random.fold_in(key, update),
            num_envs=settings.num_eval_envs,
            episode_length=settings.actions_per_episode,
        )

    def training_metrics(
        self, state: TrainingState, sums: Mapping[str, Any], num_updates: int
    ) -> dict[str, float]:
        """Lengths are in environment steps."""
        values = {name: float(value) for name, value in sums.items()}
        names = ("episodes", "score", "length", "falls")
        episodes, score, length, falls = (values.pop(name) for name in names)
        metrics = {f"training/{name}": value / num_updates for name, value in values.items()}
        if episodes:
            metrics["training/episode_reward"] = score / episodes
            metrics["training/episode_length"] = length / episodes * self.settings.action_repeat
            metrics["training/fall_rate"] = falls / episodes
        return metrics

    def after_evaluation(
        self, state: TrainingState, totals: EpisodeTotals
    ) -> tuple[TrainingState, dict[str, float]]:
        return state, evaluation_metrics(totals, self.settings.action_repeat)

    def policy(self, state: TrainingState) -> bytes:
        """(normaliser, policy, value) in the file that `brax.io.model.load_params` reads."""
        config = PolicyConfig.of(self.settings.model_dump())
        return write_policy(PolicyParams(state.normalizer, state.params.policy, state.params.value, config))

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        return {}
