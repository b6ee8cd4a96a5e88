"""The state of a SAC run, and one update of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import RunningStatisticsState, Transition, running_statistics
from core.algorithms.experience import Outcome, Starts, collect, summarise
from core.algorithms.normalizer import init_normalizer, normalization
from core.algorithms.sac import replay as replays
from core.algorithms.sac.losses import alpha_loss, critic_loss, policy_loss
from core.algorithms.sac.networks import Networks, Params, make_networks
from core.algorithms.sac.spec import SACSpec
from core.environments.environment import Environment
from core.environments.wrappers.autoreset import Episodes, fresh_states, start_episodes
from core.environments.wrappers.curriculum import at_progress, progress_at, progress_metrics
from core.environments.wrappers.vectorized import VectorEnv

ADAM = optax.scale_by_adam()
# Checked after each update, in the order in which one spoils the next.
QUANTITIES = ("observation", "reward", "critic loss", "policy loss", "entropy weight", "parameters")
_LOSSES = ("critic_loss", "policy_loss", "alpha")


@struct.dataclass
class Hyperparameters:
    """What may change without recompiling; [] float32 each."""

    learning_rate: jax.Array
    discounting: jax.Array
    reward_scaling: jax.Array
    tau: jax.Array
    target_entropy_per_action: jax.Array

    @classmethod
    def of(cls, settings: SACSpec) -> "Hyperparameters":
        return cls(**{name: jnp.float32(getattr(settings, name)) for name in cls.__dataclass_fields__})


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    target_q: the critics that follow. key: the next update's random key. eval_key: the random key of every
    evaluation, never changed. num_updates: [] int32, updates made so far.
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
        return TrainingState(
            params=params,
            target_q=params.q,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(cast("Any", params))),
            normalizer=init_normalizer(self.environment.observation_size),
            replay=replays.empty(settings.replay_rows, settings.num_envs, *sizes),
            episodes=start_episodes(
                self._envs_at(self._progress(jnp.int32(0))),
                env_key,
                settings.num_envs,
                keep_first=settings.returns_to_first_state,
            ),
            key=key,
            eval_key=eval_key,
            num_updates=jnp.int32(0),
        )

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act `unroll_length` times in each environment, and then learn from samples of all that is kept."""
        settings = self.settings
        act_key, learn_key, next_key, starts_key = jax.random.split(state.key, 4)
        progress = self._progress(state.num_updates)
        policy = self.networks.acting(state.params.policy, self.normalize(state.normalizer))
        episodes, (transitions, outcome) = collect(
            self._envs,
            policy,
            state.episodes,
            jax.random.split(act_key, settings.unroll_length),
            episode_length=settings.actions_per_episode,
            starts=self._starts(starts_key, progress),
        )
        normalizer = state.normalizer
        if settings.normalize_observations:
            normalizer = running_statistics.update(normalizer, transitions.observation)
        replay = replays.added(state.replay, _rows(transitions, outcome))
        # Counted for one environment: those of all pass 2**31 in a long run.
        enough = replay.written >= -(-settings.min_replay_size // settings.num_envs)
        enough &= replay.written > settings.n_step
        learn = partial(self._learn, replay, self.normalize(normalizer), hyperparameters, learn_key)
        # The replay is read, not passed through: a conditional would copy it.
        learnt, metrics = jax.lax.cond(
            enough, learn, self._unlearnt, (state.params, state.target_q, state.optimizer)
        )
        params, target_q, optimizer = learnt
        new = TrainingState(
            params=params,
            target_q=target_q,
            optimizer=optimizer,
            normalizer=normalizer,
            replay=replay,
            episodes=episodes,
            key=next_key,
            eval_key=state.eval_key,
            num_updates=state.num_updates + 1,
        )
        metrics = metrics | progress_metrics(progress)
        return new, summarise(outcome) | metrics, _failure(transitions, outcome, metrics, params)

    @property
    def networks(self) -> Networks:
        return make_networks(*self._sizes, self.settings)

    def normalize(self, normalizer: RunningStatisticsState) -> Any:
        """Raw observations as the networks take them."""
        if not self.settings.normalize_observations:
            return lambda observation: observation
        normalize = normalization(self.settings.normalize_observations_max_abs_value)
        return lambda observation: normalize(observation, normalizer)

    @property
    def _sizes(self) -> tuple[int, int]:
        """Of an observation and an action. Raises ValueError where the environment has several by name."""
        observation = self.environment.observation_size
        if isinstance(observation, Mapping):
            raise ValueError(f"SAC learns from one observation; there are {sorted(observation)}.")
        return observation, self.environment.action_size

    @property
    def _envs(self) -> VectorEnv:
        return VectorEnv(self.environment)

    def _progress(self, num_updates: jax.Array) -> jax.Array | None:
        """Of the environment's curriculum, if it has one."""
        return progress_at(self.environment, num_updates, self.settings.env_steps_per_update)

    def _envs_at(self, progress: jax.Array | None) -> VectorEnv:
        return replace(self._envs, environment=at_progress(self.environment, progress))

    def _starts(self, key: jax.Array, progress: jax.Array | None) -> Starts | None:
        """Initial states of one update's episodes: drawn from its key, so that no state has to hold them."""
        settings = self.settings
        if settings.returns_to_first_state:
            return None
        pool_key, choose_key = jax.random.split(key)
        shape = (settings.unroll_length, settings.num_envs)
        return Starts(
            pool=fresh_states(self._envs_at(progress), pool_key, settings.reset_pool_size),
            chosen=jax.random.randint(choose_key, shape, 0, settings.reset_pool_size),
        )

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


def _rows(transitions: Transition, outcome: Outcome) -> replays.Rows:
    extras = cast("Any", transitions.extras)
    return replays.Rows(
        observation=cast("Any", transitions.observation),
        action=extras["policy_extras"]["action"],
        reward=transitions.reward,
        ended=outcome.fell,
        truncated=extras["state_extras"]["truncation"],
    )


def _failure(
    transitions: Transition, outcome: Outcome, metrics: dict[str, jax.Array], params: Params
) -> Failure:
    """What went wrong in an update, if anything did."""
    bad_obs = ~jnp.all(jnp.isfinite(cast("Any", transitions.next_observation)), axis=(1, 2))
    bad_reward = ~jnp.all(jnp.isfinite(outcome.reward), axis=1)
    bad_params = [~jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(params)]
    quantities = [
        jnp.any(bad_obs),
        jnp.any(bad_reward),
        *(~jnp.isfinite(metrics[name]) for name in _LOSSES),
        jnp.any(jnp.stack(bad_params)),
    ]
    bad = bad_obs | bad_reward
    first = jnp.where(jnp.any(bad), jnp.argmax(bad), len(bad)).astype(jnp.int32)
    return Failure(jnp.stack(quantities), first)
