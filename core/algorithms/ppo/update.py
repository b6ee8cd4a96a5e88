"""One PPO update, and many of them in one compiled loop of any length."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from core.algorithms.ppo.brax_training import (
    PPONetworkParams,
    RunningStatisticsState,
    Transition,
    compute_ppo_loss,
    make_inference_fn,
    running_statistics,
)
from core.algorithms.ppo.experience import (
    Outcome,
    Starts,
    bootstrap_timeouts,
    collect,
    cut_into_unrolls,
    summarise,
)
from core.algorithms.ppo.layout import ONE_DEVICE, Layout
from core.algorithms.ppo.learning_rate import adapt_to_kl
from core.algorithms.ppo.networks import init_normalizer, init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import Environment
from core.environments.worlds import Worlds
from core.environments.wrappers import Episodes, fresh_states, start_episodes

ADAM = optax.scale_by_adam()

# What is looked at after each update, in the order in which one spoils the next.
QUANTITIES = (
    "observation",
    "reward",
    "policy loss",
    "value loss",
    "entropy loss",
    "gradient",
    "parameters",
)


@struct.dataclass
class Hyperparameters:
    """What may change without recompiling; [] float32 each, infinite where a bound is not set.

    Whether values are clipped at all, and whether the learning rate adapts, is compiled in.
    """

    learning_rate: jax.Array
    entropy_cost: jax.Array
    desired_kl: jax.Array
    learning_rate_schedule_min_lr: jax.Array
    learning_rate_schedule_max_lr: jax.Array
    discounting: jax.Array
    gae_lambda: jax.Array
    reward_scaling: jax.Array
    clipping_epsilon: jax.Array
    clipping_epsilon_value: jax.Array
    vf_loss_coefficient: jax.Array
    max_grad_norm: jax.Array

    @classmethod
    def of(cls, settings: PPOSpec) -> "Hyperparameters":
        given = {name: getattr(settings, name) for name in cls.__dataclass_fields__}
        return cls(
            **{name: jnp.float32(jnp.inf if value is None else value) for name, value in given.items()}
        )


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    learning_rate: [] float32, that of the last minibatch, from which an adaptive one goes on; 0 before the
    first. num_updates: [] int32, updates made so far. key: the next update's randomness. eval_key: the
    evaluations' randomness, the same throughout.
    """

    params: PPONetworkParams
    optimizer: optax.ScaleByAdamState
    learning_rate: jax.Array
    normalizer: RunningStatisticsState
    episodes: Episodes
    key: jax.Array
    eval_key: jax.Array
    num_updates: jax.Array


class Failure(NamedTuple):
    """Which of QUANTITIES were not finite in an update, and at which of its time steps, if it was there.

    quantities: [len(QUANTITIES)] bool. time_step: [] int32, the first at which an observation or reward
    was not finite; the number of time steps if none was.
    """

    quantities: jax.Array
    time_step: jax.Array


@dataclass(frozen=True)
class Learner:
    """The pure functions of a run, for one environment and the settings that fix shapes.

    layout: the devices that share it. What a run computes does not depend on them but for rounding: random
    numbers and minibatches are drawn for all environments at once, and then shared out.
    """

    environment: Environment
    settings: PPOSpec
    layout: Layout = ONE_DEVICE

    def init(self, seed: jax.Array) -> TrainingState:
        """The state before the first update; seed: [] uint32."""
        params_key, env_key, key, eval_key = jax.random.split(jax.random.PRNGKey(seed), 4)
        params = init_params(self._networks(normalize=True), params_key)
        return TrainingState(
            params=params,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(cast("Any", params))),
            learning_rate=jnp.float32(0),
            normalizer=init_normalizer(self.environment.observation_size),
            episodes=start_episodes(
                self._worlds,
                env_key,
                self.settings.num_envs,
                keep_first=self.settings.returns_to_first_state,
            ),
            key=key,
            eval_key=eval_key,
            num_updates=jnp.int32(0),
        )

    def epoch(
        self, state: TrainingState, hyperparameters: Hyperparameters, until: jax.Array
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Update until `until` [] int32 updates are made, or one of them brings a value that is not finite.

        Returns the state after the last good update, metrics summed over the good ones, and what went
        wrong in the bad one. How a run is cut into epochs changes nothing in it.
        """
        # Traced once for both places below, and copied into the second as if it had been traced there.
        update = jax.jit(self.update, inline=True)

        def going(carry: tuple[TrainingState, Any, Failure]) -> jax.Array:
            state, _, failure = carry
            return (state.num_updates < until) & ~jnp.any(failure.quantities)

        def advance(carry: tuple[TrainingState, Any, Failure]) -> tuple[TrainingState, Any, Failure]:
            state, sums, _ = carry
            new, metrics, failure = update(state, hyperparameters)
            good = ~jnp.any(failure.quantities)
            keep = partial(jax.tree.map, lambda a, b: jnp.where(good, a, b))
            return keep(new, state), keep(jax.tree.map(jnp.add, sums, metrics), sums), failure

        shapes = jax.eval_shape(update, state, hyperparameters)[1:]
        sums, failure = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
        return jax.lax.while_loop(going, advance, (state, sums, failure))

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act, update the normaliser, pass over the batch `num_updates_per_batch` times: Brax's order."""
        settings = self.settings
        act_key, learn_key, next_key, starts_key = jax.random.split(state.key, 4)
        networks = self._networks(normalize=settings.normalize_observations)
        policy = make_inference_fn(networks, compute_value=self._values_are_kept)(
            (state.normalizer, state.params.policy, state.params.value)
        )
        episodes, (transitions, outcome) = collect(
            self._worlds,
            policy,
            state.episodes,
            jax.random.split(act_key, settings.actions_per_update),
            episode_length=settings.actions_per_episode,
            starts=self._starts(starts_key),
        )
        learnt_from = transitions
        if settings.bootstrap_on_timeout:
            learnt_from = bootstrap_timeouts(
                transitions, hyperparameters.discounting, hyperparameters.reward_scaling
            )
        batch = cut_into_unrolls(learnt_from, settings.unroll_length)
        normalizer = state.normalizer
        if settings.normalize_observations:
            normalizer = running_statistics.update(normalizer, batch.observation)
            # What the policy said is comparable with what it says now only under the same normaliser.
            seen_by = state.normalizer if self._adapts_to_kl else normalizer
            batch = batch._replace(
                observation=running_statistics.normalize(batch.observation, seen_by),
                next_observation=running_statistics.normalize(batch.next_observation, seen_by),
            )
        batch = self.layout.everywhere(batch)  # so that any device can take any part of a minibatch
        (params, optimizer, learning_rate), metrics = self._learn(state, batch, hyperparameters, learn_key)
        new = TrainingState(
            params=params,
            optimizer=optimizer,
            learning_rate=learning_rate,
            normalizer=normalizer,
            episodes=episodes,
            key=next_key,
            eval_key=state.eval_key,
            num_updates=state.num_updates + 1,
        )
        return new, summarise(outcome) | metrics, _failure(transitions, outcome, metrics, params)

    @property
    def _worlds(self) -> Worlds:
        return Worlds(self.environment, self.layout.mesh)

    @property
    def _adapts_to_kl(self) -> bool:
        return self.settings.learning_rate_schedule == "ADAPTIVE_KL"

    @property
    def _values_are_kept(self) -> bool:
        """Whether the loss needs the values at the time of acting."""
        return self.settings.bootstrap_on_timeout or self.settings.clipping_epsilon_value is not None

    def _starts(self, key: jax.Array) -> Starts | None:
        """Where the episodes of one update begin: made anew from its key, so that no state need hold them."""
        settings = self.settings
        if settings.returns_to_first_state:
            return None
        pool_key, choose_key = jax.random.split(key)
        shape = (settings.actions_per_update, settings.num_envs)
        return Starts(
            pool=self.layout.everywhere(fresh_states(self._worlds, pool_key, settings.reset_pool_size)),
            chosen=self.layout.split(
                jax.random.randint(choose_key, shape, 0, settings.reset_pool_size), axis=1
            ),
        )

    def _learn(
        self, state: TrainingState, batch: Transition, hyperparameters: Hyperparameters, key: jax.Array
    ) -> tuple[tuple[PPONetworkParams, optax.ScaleByAdamState, jax.Array], dict[str, jax.Array]]:
        """Several passes over a batch [unrolls, unroll_length, ...] of normalised observations.

        Returns (parameters, optimiser, learning rate) and means of the losses.
        """
        settings = self.settings
        num_unrolls = settings.batch_size * settings.num_minibatches
        loss = self._loss(state.normalizer, hyperparameters)

        def learn_pass(carry: Any, key: jax.Array) -> tuple[Any, Any]:
            order_key, loss_key = jax.random.split(key)
            order = jax.random.permutation(order_key, num_unrolls).reshape(settings.num_minibatches, -1)
            return jax.lax.scan(learn_minibatch, carry, (order, jax.random.split(loss_key, len(order))))

        def learn_minibatch(carry: Any, given: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
            params, optimizer, learning_rate = carry
            chosen, key = given
            minibatch = self.layout.split(jax.tree.map(lambda x: jnp.take(x, chosen, axis=0), batch))
            gradient, metrics = jax.grad(loss, has_aux=True)(params, minibatch, key)
            norm = optax.tree.norm(gradient)
            bound = hyperparameters.max_grad_norm
            gradient = jax.tree.map(lambda g: jnp.where(norm < bound, g, g / norm * bound), gradient)
            metrics = metrics | {"grad_norm": norm}
            if self._adapts_to_kl:
                learning_rate = adapt_to_kl(
                    learning_rate,
                    metrics["kl_mean"],
                    hyperparameters.desired_kl,
                    (
                        hyperparameters.learning_rate_schedule_min_lr,
                        hyperparameters.learning_rate_schedule_max_lr,
                    ),
                )
                metrics = metrics | {"learning_rate": learning_rate}
            direction, optimizer = ADAM.update(gradient, optimizer)
            params = jax.tree.map(lambda p, d: p - learning_rate * d, params, direction)
            return (params, optimizer, learning_rate), metrics

        learning_rate = hyperparameters.learning_rate
        if self._adapts_to_kl:
            learning_rate = jnp.where(state.num_updates == 0, learning_rate, state.learning_rate)
        learnt, metrics = jax.lax.scan(
            learn_pass,
            (state.params, state.optimizer, learning_rate),
            jax.random.split(key, settings.num_updates_per_batch),
        )
        return learnt, jax.tree.map(jnp.mean, metrics)

    def _loss(self, normalizer: RunningStatisticsState, hyperparameters: Hyperparameters) -> Any:
        clipped = self.settings.clipping_epsilon_value is not None
        networks = self._networks(normalize=False)  # once for the batch, not in every minibatch

        def loss(params: PPONetworkParams, minibatch: Transition, key: jax.Array) -> Any:
            return compute_ppo_loss(
                params,
                normalizer,  # not used: these networks do not normalise
                minibatch,
                key,
                networks,
                entropy_cost=hyperparameters.entropy_cost,  # pyright: ignore[reportArgumentType]
                discounting=hyperparameters.discounting,  # pyright: ignore[reportArgumentType]
                reward_scaling=hyperparameters.reward_scaling,  # pyright: ignore[reportArgumentType]
                gae_lambda=hyperparameters.gae_lambda,  # pyright: ignore[reportArgumentType]
                clipping_epsilon=hyperparameters.clipping_epsilon,  # pyright: ignore[reportArgumentType]
                normalize_advantage=self.settings.normalize_advantage,
                vf_coefficient=hyperparameters.vf_loss_coefficient,  # pyright: ignore[reportArgumentType]
                clipping_epsilon_value=hyperparameters.clipping_epsilon_value if clipped else None,  # pyright: ignore[reportArgumentType]
            )

        return loss

    def _networks(self, *, normalize: bool) -> Any:
        environment = self.environment
        return make_networks(
            environment.observation_size, environment.action_size, self.settings, normalize=normalize
        )


def _failure(
    transitions: Transition, outcome: Outcome, metrics: dict[str, jax.Array], params: PPONetworkParams
) -> Failure:
    """transitions, outcome: [T, N, ...]."""
    seen = jax.tree.leaves(transitions.next_observation)
    bad_obs = ~jnp.all(jnp.stack([jnp.all(jnp.isfinite(x), axis=(1, 2)) for x in seen]), axis=0)
    bad_reward = ~jnp.all(jnp.isfinite(outcome.reward), axis=1)
    bad_params = [~jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(params)]
    losses = [metrics[name] for name in ("policy_loss", "v_loss", "entropy_loss", "grad_norm")]
    quantities = jnp.stack(
        [
            jnp.any(bad_obs),
            jnp.any(bad_reward),
            *(~jnp.isfinite(value) for value in losses),
            jnp.any(jnp.stack(bad_params)),
        ]
    )
    bad = bad_obs | bad_reward
    first = jnp.where(jnp.any(bad), jnp.argmax(bad), len(bad)).astype(jnp.int32)
    return Failure(quantities, first)
