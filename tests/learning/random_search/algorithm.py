"""Random search over linear policies: the whole of an algorithm, for whoever writes the next one."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.checkpoint import Format, describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.sharding import ONE_DEVICE
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments.environment import Environment
from tests.learning.random_search.spec import RandomSearchSpec

FORMAT = Format("gaitway-random_search-1")
Metrics = dict[str, float]


@struct.dataclass
class TrainingState:
    """weights: [obs, act]; the action is obs @ weights."""

    weights: jax.Array
    key: jax.Array
    eval_key: jax.Array
    num_updates: jax.Array


class RandomSearch:
    """See `core.algorithms.algorithm.Algorithm`."""

    format = FORMAT
    quantities = ("return", "weights")
    sharding = ONE_DEVICE
    split_fields = ()

    def __init__(
        self, environment: Environment, settings: RandomSearchSpec, *, seed: int, devices: int = 1
    ) -> None:
        settings.check_sharing(devices)
        self.settings = settings
        self.seed = jnp.uint32(seed)
        self.hyperparameters = (jnp.float32(settings.learning_rate), jnp.float32(settings.noise))
        self.description = self.header = describe(environment, settings)
        self.env_steps_per_time_step = settings.num_parallel_envs
        self._environment = environment

    def init(self, seed: jax.Array) -> TrainingState:
        key, eval_key = jax.random.split(jax.random.PRNGKey(seed))
        shape = (cast("int", self._environment.observation_size), self._environment.action_size)
        return TrainingState(jnp.zeros(shape), key, eval_key, jnp.int32(0))

    def update(
        self, state: TrainingState, hyperparameters: tuple[jax.Array, jax.Array]
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        (learning_rate, noise), num = hyperparameters, self.settings.num_directions
        next_key, direction_key, start_key = jax.random.split(state.key, 3)
        directions = jax.random.normal(direction_key, (num, *state.weights.shape))
        both = jnp.concatenate([state.weights + noise * directions, state.weights - noise * directions])
        totals = self._episodes(both, start_key, num, copies=2)  # The same starts for both signs.
        plus, minus = jnp.split(totals.metrics["reward"], 2)
        weights = state.weights + learning_rate * jnp.mean((plus - minus)[:, None, None] * directions, axis=0)
        bad = jnp.stack([~jnp.all(jnp.isfinite(value)) for value in (plus + minus, weights)])
        new = replace(state, weights=weights, key=next_key, num_updates=state.num_updates + 1)
        failure = Failure(bad, jnp.int32(self.settings.episode_length))
        return new, {"episode_reward": jnp.mean(plus + minus) / 2}, failure

    def evaluated(self, state: TrainingState) -> jax.Array:
        return state.weights

    def evaluate(self, evaluated: jax.Array, key: jax.Array, update: jax.Array) -> EpisodeTotals:
        weights = jnp.broadcast_to(evaluated, (self.settings.num_eval_envs, *evaluated.shape))
        return self._episodes(weights, jax.random.fold_in(key, update), len(weights), copies=1)

    def training_metrics(self, state: TrainingState, sums: Mapping[str, Any], num_updates: int) -> Metrics:
        return {f"training/{name}": float(value) / num_updates for name, value in sums.items()}

    def after_evaluation(self, state: TrainingState, totals: EpisodeTotals) -> tuple[TrainingState, Metrics]:
        return state, evaluation_metrics(totals)

    def policy(self, state: TrainingState) -> bytes:
        return FORMAT.pack(self.header, {}, {"weights": np.asarray(state.weights)})

    def tables(self, state: TrainingState) -> Mapping[str, NDArray[Any]]:
        return {}

    def _episodes(self, weights: jax.Array, key: jax.Array, num_envs: int, copies: int) -> EpisodeTotals:
        """One episode under each of the weights [copies * num_envs, obs, act]."""

        def policy(obs: jax.Array, _: jax.Array) -> tuple[jax.Array, tuple[()]]:
            return jnp.einsum("no,noa->na", obs, weights), ()

        length = self.settings.episode_length
        return run_episodes(
            self._environment, policy, key, num_envs=num_envs, episode_length=length, copies=copies
        )


def load(content: bytes, *, is_checkpoint: bool, deterministic: bool = True) -> TrainedPolicy:
    """Checkpoints and policy files both hold the weights; there is no noise to leave out."""
    weights = jnp.asarray(FORMAT.read(content)[1]["weights"])

    def acting(environment: Environment) -> Acting:
        return Acting(environment, lambda weights, state, key: state.obs @ weights)

    return TrainedPolicy(weights, acting)
