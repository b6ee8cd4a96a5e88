"""The deep Q-network: the state of a run, one update of it, and its `Algorithm`."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import RunningStatisticsState
from core.algorithms.checkpoint import describe
from core.algorithms.dqn.network import QNetwork, acting, td_loss
from core.algorithms.dqn.policy import FORMAT, write_policy
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.evaluation import EpisodeTotals, Policy, evaluation_metrics, run_episodes
from core.algorithms.experience import any_not_finite, decayed, find_failure, summarise, training_metrics
from core.algorithms.off_policy import replay as replays
from core.algorithms.off_policy.acting import (
    Experience,
    act,
    first_experience,
    normalize,
    observation_size,
    progress,
)
from core.algorithms.q_learning.discrete_env import make_action_set
from core.algorithms.sharding import ONE_DEVICE
from core.environments.environment import ActionSet, Environment
from core.environments.wrappers.action_repeat import repeat_action
from core.environments.wrappers.autoreset import Episodes
from core.environments.wrappers.curriculum import progress_metrics
from core.errors import Rejected

ADAM = optax.scale_by_adam()
# Checked after each update, in the order in which one spoils the next.
QUANTITIES = ("observation", "reward", "loss", "parameters")
_METRICS = ("loss", "q_value", "td_error")


@struct.dataclass
class Hyperparameters:
    """The numbers that may change without recompiling; [] float32 each. decay_length: decisions."""

    learning_rate: jax.Array
    discounting: jax.Array
    reward_scaling: jax.Array
    tau: jax.Array
    epsilon_start: jax.Array
    epsilon_end: jax.Array
    decay_length: jax.Array

    @classmethod
    def of(cls, settings: DQNSpec) -> "Hyperparameters":
        epsilon = settings.epsilon
        return cls(
            learning_rate=jnp.float32(settings.learning_rate),
            discounting=jnp.float32(settings.discounting),
            reward_scaling=jnp.float32(settings.reward_scaling),
            tau=jnp.float32(settings.tau),
            epsilon_start=jnp.float32(epsilon.start),
            epsilon_end=jnp.float32(epsilon.end),
            decay_length=jnp.float32(epsilon.decay_decisions or settings.num_actions),
        )


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    target: the parameters that follow. key: the next update's random key. eval_key: the random key of every
    evaluation, never changed. num_updates: [] int32, updates made so far.
    """

    params: Any
    target: Any
    optimizer: optax.ScaleByAdamState
    normalizer: RunningStatisticsState
    replay: replays.Replay
    episodes: Episodes
    key: jax.Array
    eval_key: jax.Array
    num_updates: jax.Array


# Parameters, those that follow, the optimiser.
Learnt = tuple[Any, Any, optax.ScaleByAdamState]


@dataclass(frozen=True)
class Learner:
    """The pure functions of a run. environment: with actions held; action_set: its choices; settings: what
    fixes shapes."""

    environment: Environment
    action_set: ActionSet
    settings: DQNSpec

    def init(self, seed: jax.Array) -> TrainingState:
        """The state before the first update; seed: [] uint32."""
        params_key, env_key, key, eval_key = jax.random.split(jax.random.PRNGKey(seed), 4)
        params = self.network.init(params_key, observation_size(self.environment, self.settings))
        seen = first_experience(self.environment, self.settings, env_key, self.action_set.num_parts)
        return TrainingState(
            params=params,
            target=params,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(params)),
            normalizer=seen.normalizer,
            replay=seen.replay,
            episodes=seen.episodes,
            key=key,
            eval_key=eval_key,
            num_updates=jnp.int32(0),
        )

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act `unroll_length` times in each environment, and then learn from samples of all that is kept."""
        act_key, learn_key, next_key, starts_key = jax.random.split(state.key, 4)
        epsilon = self._epsilon(state, hyperparameters)
        policy = self.acting(state.params, state.normalizer, epsilon)
        before = Experience(state.normalizer, state.replay, state.episodes)
        at = progress(self.environment, self.settings, state.num_updates)
        seen, acted = act(self.environment, self.settings, policy, before, (act_key, starts_key), at)
        learn = partial(
            self._learn, seen.replay, normalize(self.settings, seen.normalizer), hyperparameters, learn_key
        )
        # The replay is read, not passed through: a conditional would copy it.
        learnt, metrics = jax.lax.cond(
            acted.enough, learn, _unlearnt, (state.params, state.target, state.optimizer)
        )
        params, target, optimizer = learnt
        new = TrainingState(
            params=params,
            target=target,
            optimizer=optimizer,
            normalizer=seen.normalizer,
            replay=seen.replay,
            episodes=seen.episodes,
            key=next_key,
            eval_key=state.eval_key,
            num_updates=state.num_updates + 1,
        )
        failed = find_failure(
            acted.transitions.next_observation,
            acted.outcome,
            [~jnp.isfinite(metrics["loss"]), any_not_finite(params)],
        )
        return new, summarise(acted.outcome) | metrics | {"epsilon": epsilon} | progress_metrics(at), failed

    @property
    def network(self) -> QNetwork:
        settings = self.settings
        sizes, choices = tuple(settings.hidden_layer_sizes), self.action_set
        return QNetwork(choices.num_parts, choices.num_choices, sizes, settings.activation)

    def acting(
        self, params: Any, normalizer: RunningStatisticsState, epsilon: jax.Array | None = None
    ) -> Policy:
        """The policy of these parameters; without epsilon, no choice is random."""
        return acting(self.network, self.action_set, params, normalize(self.settings, normalizer), epsilon)

    def _epsilon(self, state: TrainingState, hyperparameters: Hyperparameters) -> jax.Array:
        """That of one update, by the decisions before it."""
        # In float32 from the beginning: a long run has more decisions than an int32 counts.
        decisions = state.num_updates.astype(jnp.float32) * (
            self.settings.unroll_length * self.settings.num_envs
        )
        return decayed(
            hyperparameters.epsilon_start,
            hyperparameters.epsilon_end,
            decisions / hyperparameters.decay_length,
            self.settings.epsilon.shape,
        )

    def _learn(
        self,
        replay: replays.Replay,
        normalize: Any,
        hyperparameters: Hyperparameters,
        key: jax.Array,
        learnt: Learnt,
    ) -> tuple[Learnt, dict[str, jax.Array]]:
        """Gradient steps on samples of the replay, and means of their metrics."""
        settings = self.settings

        def gradient_step(learnt: Learnt, key: jax.Array) -> tuple[Learnt, dict[str, jax.Array]]:
            params, target, optimizer = learnt
            batch = replays.sample(
                replay,
                key,
                settings.batch_size,
                n_step=settings.n_step,
                discounting=hyperparameters.discounting,
            )
            batch = batch._replace(
                observation=normalize(batch.observation),
                next_observation=normalize(batch.next_observation),
                reward=batch.reward * hyperparameters.reward_scaling,
            )
            gradient, metrics = jax.grad(td_loss, has_aux=True)(params, target, self.network, batch)
            direction, optimizer = ADAM.update(gradient, optimizer)
            params = jax.tree.map(lambda p, d: p - hyperparameters.learning_rate * d, params, direction)
            target = jax.tree.map(lambda old, new: old + hyperparameters.tau * (new - old), target, params)
            return (params, target, cast("optax.ScaleByAdamState", optimizer)), metrics

        steps = settings.unroll_length * settings.grad_updates_per_step
        learnt, metrics = jax.lax.scan(gradient_step, learnt, jax.random.split(key, steps))
        return learnt, jax.tree.map(jnp.mean, metrics)


def _unlearnt(learnt: Learnt) -> tuple[Learnt, dict[str, jax.Array]]:
    return learnt, {name: jnp.float32(0) for name in _METRICS}


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
