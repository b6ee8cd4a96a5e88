"""One PPO update, and many of them in one compiled loop of any length."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from brax.training.acme import running_statistics
from brax.training.acme.running_statistics import RunningStatisticsState
from brax.training.agents.ppo.losses import PPONetworkParams, compute_ppo_loss
from brax.training.agents.ppo.networks import make_inference_fn
from brax.training.types import Transition
from flax import struct

from core.algorithms.ppo.experience import Outcome, collect, cut_into_unrolls, summarise
from core.algorithms.ppo.networks import init_normalizer, init_params, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import Environment
from core.environments.wrappers import Episodes, start_episodes

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
    """What may change without recompiling; [] float32 each."""

    learning_rate: jax.Array
    entropy_cost: jax.Array
    discounting: jax.Array
    gae_lambda: jax.Array
    reward_scaling: jax.Array
    clipping_epsilon: jax.Array
    vf_loss_coefficient: jax.Array
    max_grad_norm: jax.Array

    @classmethod
    def of(cls, settings: PPOSpec) -> "Hyperparameters":
        names = set(cls.__dataclass_fields__) - {"max_grad_norm"}
        bound = float("inf") if settings.max_grad_norm is None else settings.max_grad_norm
        values = {name: getattr(settings, name) for name in names} | {"max_grad_norm": bound}
        return cls(**{name: jnp.float32(value) for name, value in values.items()})


@struct.dataclass
class TrainingState:
    """Everything that a run's future depends on, besides its settings.

    num_updates: [] int32, updates made so far. key: the next update's randomness. eval_key: the
    evaluations' randomness, the same throughout.
    """

    params: PPONetworkParams
    optimizer: optax.ScaleByAdamState
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
    """The pure functions of a run, for one environment and the settings that fix shapes."""

    environment: Environment
    settings: PPOSpec

    def init(self, seed: jax.Array) -> TrainingState:
        """The state before the first update; seed: [] uint32."""
        params_key, env_key, key, eval_key = jax.random.split(jax.random.PRNGKey(seed), 4)
        params = init_params(self._networks(normalize=True), params_key)
        return TrainingState(
            params=params,
            optimizer=cast("optax.ScaleByAdamState", ADAM.init(cast("Any", params))),
            normalizer=init_normalizer(self.environment.observation_size),
            episodes=start_episodes(self.environment, env_key, self.settings.num_envs),
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

        def going(carry: tuple[TrainingState, Any, Failure]) -> jax.Array:
            state, _, failure = carry
            return (state.num_updates < until) & ~jnp.any(failure.quantities)

        def advance(carry: tuple[TrainingState, Any, Failure]) -> tuple[TrainingState, Any, Failure]:
            state, sums, _ = carry
            new, metrics, failure = self.update(state, hyperparameters)
            good = ~jnp.any(failure.quantities)
            keep = partial(jax.tree.map, lambda a, b: jnp.where(good, a, b))
            return keep(new, state), keep(jax.tree.map(jnp.add, sums, metrics), sums), failure

        shapes = jax.eval_shape(self.update, state, hyperparameters)[1:]
        sums, failure = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
        return jax.lax.while_loop(going, advance, (state, sums, failure))

    def update(
        self, state: TrainingState, hyperparameters: Hyperparameters
    ) -> tuple[TrainingState, dict[str, jax.Array], Failure]:
        """Act, update the normaliser, pass over the batch `num_updates_per_batch` times: Brax's order."""
        settings = self.settings
        act_key, learn_key, next_key = jax.random.split(state.key, 3)
        policy = make_inference_fn(self._networks(normalize=settings.normalize_observations))(
            (state.normalizer, state.params.policy, state.params.value)
        )
        episodes, (transitions, outcome) = collect(
            self.environment,
            policy,
            state.episodes,
            act_key,
            num_steps=settings.env_steps_per_update // settings.num_envs,
            episode_length=settings.episode_length,
        )
        batch = cut_into_unrolls(transitions, settings.unroll_length)
        normalizer = state.normalizer
        if settings.normalize_observations:
            normalizer = running_statistics.update(normalizer, batch.observation)
            batch = batch._replace(
                observation=running_statistics.normalize(batch.observation, normalizer),
                next_observation=running_statistics.normalize(batch.next_observation, normalizer),
            )
        params, optimizer, metrics = self._learn(state, batch, hyperparameters, learn_key)
        new = TrainingState(
            params=params,
            optimizer=optimizer,
            normalizer=normalizer,
            episodes=episodes,
            key=next_key,
            eval_key=state.eval_key,
            num_updates=state.num_updates + 1,
        )
        return new, metrics | summarise(outcome), _failure(transitions, outcome, metrics, params)

    def _learn(
        self, state: TrainingState, batch: Transition, hyperparameters: Hyperparameters, key: jax.Array
    ) -> tuple[PPONetworkParams, optax.ScaleByAdamState, dict[str, jax.Array]]:
        """Several passes over a batch [unrolls, unroll_length, ...] of normalised observations."""
        settings = self.settings
        num_unrolls = settings.batch_size * settings.num_minibatches
        loss = self._loss(hyperparameters)

        def learn_pass(carry: Any, key: jax.Array) -> tuple[Any, Any]:
            order_key, loss_key = jax.random.split(key)
            order = jax.random.permutation(order_key, num_unrolls).reshape(settings.num_minibatches, -1)
            return jax.lax.scan(learn_minibatch, carry, (order, jax.random.split(loss_key, len(order))))

        def learn_minibatch(carry: Any, given: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
            params, optimizer = carry
            chosen, key = given
            minibatch = jax.tree.map(lambda x: jnp.take(x, chosen, axis=0), batch)
            gradient, metrics = jax.grad(loss, has_aux=True)(params, minibatch, key)
            norm = optax.tree.norm(gradient)
            bound = hyperparameters.max_grad_norm
            gradient = jax.tree.map(lambda g: jnp.where(norm < bound, g, g / norm * bound), gradient)
            direction, optimizer = ADAM.update(gradient, optimizer)
            params = jax.tree.map(lambda p, d: p - hyperparameters.learning_rate * d, params, direction)
            return (params, optimizer), metrics | {"grad_norm": norm}

        (params, optimizer), metrics = jax.lax.scan(
            learn_pass,
            (state.params, state.optimizer),
            jax.random.split(key, settings.num_updates_per_batch),
        )
        return params, optimizer, jax.tree.map(jnp.mean, metrics)

    def _loss(self, hyperparameters: Hyperparameters) -> Any:
        networks = self._networks(normalize=False)  # once for the batch, not in every minibatch

        def loss(params: PPONetworkParams, minibatch: Transition, key: jax.Array) -> Any:
            return compute_ppo_loss(
                params,
                (),
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
    bad_obs = ~jnp.all(jnp.isfinite(transitions.next_observation), axis=(1, 2))
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
