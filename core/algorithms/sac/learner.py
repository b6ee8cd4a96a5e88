"""Soft actor-critic: the state of a run, one update of it, and its `Algorithm`."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct
from jaxtyping import Array, Float
from numpy.typing import NDArray

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import RunningStatisticsState
from core.algorithms.checkpoint import describe
from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.algorithms.experience import any_not_finite, find_failure, summarise, training_metrics
from core.algorithms.off_policy import replay as replays
from core.algorithms.off_policy.acting import (
    Experience,
    act,
    first_experience,
    normalize,
    observation_size,
    progress,
)
from core.algorithms.off_policy.replay import Sample
from core.algorithms.sac.networks import Networks, Params, make_networks, projected
from core.algorithms.sac.policy import FORMAT, write_policy
from core.algorithms.sac.spec import SACSpec
from core.algorithms.sharding import ONE_DEVICE
from core.environments.environment import Environment
from core.environments.wrappers.action_repeat import repeat_action
from core.environments.wrappers.autoreset import Episodes
from core.environments.wrappers.curriculum import progress_metrics

Scalar = Float[Array, ""]


def critic_loss(
    q: Any, params: Params, target_q: Any, networks: Networks, batch: Sample, key: jax.Array
) -> tuple[Scalar, Scalar]:
    """The cross-entropy of both critics with their common target, and the mean value that they expect.

    The target is the distribution of the critic that expects less, moved by the rewards, with the policy's
    entropy as a part of what follows. batch: normalised observations, scaled rewards.
    """
    following, log_prob = networks.sample(params.policy, batch.next_observation, key)
    target_logits = networks.critics.logits(target_q, batch.next_observation, following)
    distributions = jax.nn.softmax(target_logits)
    first, second = distributions @ networks.atoms
    of_less = jnp.where((first < second)[:, None], *distributions)
    worth = networks.atoms[None, :] - (jnp.exp(params.log_alpha) * log_prob)[:, None]
    moved = batch.reward[:, None] + batch.discount[:, None] * worth
    target = jax.lax.stop_gradient(projected(of_less, moved, networks.atoms))
    log_probabilities = jax.nn.log_softmax(networks.critics.logits(q, batch.observation, batch.action))
    losses = -jnp.sum(target[None] * log_probabilities, axis=-1)
    expected = jnp.exp(log_probabilities) @ networks.atoms
    return jnp.mean(losses * batch.weight) * len(losses), jnp.mean(expected)


def policy_loss(
    policy: Any, params: Params, networks: Networks, batch: Sample, key: jax.Array
) -> tuple[Scalar, Scalar]:
    """How much less than the most the policy gets, entropy included; and the actions' mean log-density."""
    action, log_prob = networks.sample(policy, batch.observation, key)
    value = jnp.min(networks.values(params.q, batch.observation, action), axis=0)
    return jnp.mean(jnp.exp(params.log_alpha) * log_prob - value), jnp.mean(log_prob)


def alpha_loss(log_alpha: Scalar, log_prob: Scalar, target_entropy: Scalar | float) -> Scalar:
    """It falls with a larger weight where the policy's entropy is below the wanted one."""
    return jnp.exp(log_alpha) * jax.lax.stop_gradient(-log_prob - target_entropy)


ADAM = optax.scale_by_adam()
# Checked after each update, in the order in which one spoils the next.
QUANTITIES = ("observation", "reward", "critic loss", "policy loss", "entropy weight", "parameters")
_LOSSES = ("critic_loss", "policy_loss", "alpha")


@struct.dataclass
class Hyperparameters:
    """The numbers that may change without recompiling; [] float32 each."""

    learning_rate: jax.Array
    discounting: jax.Array
    reward_scaling: jax.Array
    tau: jax.Array
    target_entropy_per_action: jax.Array

    @classmethod
    def of(cls, settings: SACSpec) -> "Hyperparameters":
        return cls(**{name: jnp.float32(getattr(settings, name)) for name in settings.arguments})


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    target_q: the critics that follow. key: the next update's random key. eval_key: the random key of every
    evaluation, never changed. num_updates: [] int32, updates made so far. record: see `Experience`.
    """

    params: Params
    target_q: Any
    optimizer: optax.ScaleByAdamState
    normalizer: RunningStatisticsState
    replay: replays.Replay
    episodes: Episodes
    key: jax.Array
    eval_key: jax.Array
    num_updates: jax.Array
    record: jax.Array | None = None


# Parameters, the critics that follow, the optimiser.
Learnt = tuple[Params, Any, optax.ScaleByAdamState]


@dataclass(frozen=True)
class Learner:
    """The pure functions of a run, for one environment and the settings that fix shapes."""

    environment: Environment
    settings: SACSpec

    def init(self, seed: jax.Array) -> TrainingState:
        """The state before the first update; seed: [] uint32."""
        settings, sizes = self.settings, self._sizes
        params_key, env_key, key, eval_key = jax.random.split(jax.random.PRNGKey(seed), 4)
        params = self.networks.init(params_key, *sizes, settings.init_alpha)
        seen = first_experience(self.environment, settings, env_key, self.environment.action_size)
        return TrainingState(
            params=params,
            target_q=params.q,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(cast("Any", params))),
            normalizer=seen.normalizer,
            replay=seen.replay,
            episodes=seen.episodes,
            key=key,
            eval_key=eval_key,
            num_updates=jnp.int32(0),
            record=seen.record,
        )

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act `unroll_length` times in each environment, and then learn from samples of all that is kept."""
        act_key, learn_key, next_key, starts_key = jax.random.split(state.key, 4)
        policy = self.networks.acting(state.params.policy, self.normalize(state.normalizer))
        before = Experience(state.normalizer, state.replay, state.episodes, state.record)
        at = progress(self.environment, self.settings, state.num_updates)
        seen, acted = act(self.environment, self.settings, policy, before, (act_key, starts_key), at)
        learn = partial(self._learn, seen.replay, self.normalize(seen.normalizer), hyperparameters, learn_key)
        # The replay is read, not passed through: a conditional would copy it.
        learnt, metrics = jax.lax.cond(
            acted.enough, learn, self._unlearnt, (state.params, state.target_q, state.optimizer)
        )
        params, target_q, optimizer = learnt
        new = TrainingState(
            params=params,
            target_q=target_q,
            optimizer=optimizer,
            normalizer=seen.normalizer,
            replay=seen.replay,
            episodes=seen.episodes,
            key=next_key,
            eval_key=state.eval_key,
            num_updates=state.num_updates + 1,
            record=seen.record,
        )
        of_losses = [~jnp.isfinite(metrics[name]) for name in _LOSSES]
        failed = find_failure(
            acted.transitions.next_observation, acted.outcome, [*of_losses, any_not_finite(params)]
        )
        return new, summarise(acted.outcome) | metrics | progress_metrics(at), failed

    @property
    def networks(self) -> Networks:
        return make_networks(*self._sizes, self.settings)

    def normalize(self, normalizer: RunningStatisticsState) -> Any:
        """Raw observations as the networks take them."""
        return normalize(self.settings, normalizer)

    @property
    def _sizes(self) -> tuple[int, int]:
        """The sizes of an observation and an action."""
        return observation_size(self.environment, self.settings), self.environment.action_size

    def _unlearnt(self, learnt: Learnt) -> tuple[Learnt, dict[str, jax.Array]]:
        names = ("critic_loss", "policy_loss", "q_value", "entropy")
        metrics = {name: jnp.float32(0) for name in names}
        return learnt, metrics | {"alpha": jnp.exp(learnt[0].log_alpha)}

    def _learn(
        self,
        replay: replays.Replay,
        normalize: Any,
        hyperparameters: Hyperparameters,
        key: jax.Array,
        learnt: Learnt,
    ) -> tuple[Learnt, dict[str, jax.Array]]:
        """Gradient steps on samples of the replay, and means of their metrics."""
        settings, networks = self.settings, self.networks
        target_entropy = hyperparameters.target_entropy_per_action * self.environment.action_size

        def gradient_step(carry: Any, key: jax.Array) -> tuple[Any, dict[str, jax.Array]]:
            params, target_q, optimizer = carry
            sample_key, critic_key, policy_key = jax.random.split(key, 3)
            batch = replays.sample(
                replay,
                sample_key,
                settings.batch_size,
                n_step=settings.n_step,
                discounting=hyperparameters.discounting,
            )
            batch = batch._replace(
                observation=normalize(batch.observation),
                next_observation=normalize(batch.next_observation),
                reward=batch.reward * hyperparameters.reward_scaling,
            )
            (of_critics, value), q_gradient = jax.value_and_grad(critic_loss, has_aux=True)(
                params.q, params, target_q, networks, batch, critic_key
            )
            (of_policy, log_prob), policy_gradient = jax.value_and_grad(policy_loss, has_aux=True)(
                params.policy, params, networks, batch, policy_key
            )
            alpha_gradient = jax.grad(alpha_loss)(params.log_alpha, log_prob, target_entropy)
            gradient = Params(policy_gradient, q_gradient, alpha_gradient)
            direction, optimizer = ADAM.update(cast("Any", gradient), optimizer)
            params = jax.tree.map(lambda p, d: p - hyperparameters.learning_rate * d, params, direction)
            target_q = jax.tree.map(
                lambda old, new: old + hyperparameters.tau * (new - old), target_q, params.q
            )
            metrics = {
                "critic_loss": of_critics,
                "policy_loss": of_policy,
                "q_value": value,
                "entropy": -log_prob,
                "alpha": jnp.exp(params.log_alpha),
            }
            return (params, target_q, optimizer), metrics

        steps = settings.unroll_length * settings.grad_updates_per_step
        learnt, metrics = jax.lax.scan(gradient_step, learnt, jax.random.split(key, steps))
        return learnt, jax.tree.map(jnp.mean, metrics)


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
