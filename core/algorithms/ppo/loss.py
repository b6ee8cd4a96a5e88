"""PPO's loss, a bounded step of Adam along its gradient, and learning-rate schedules."""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from core.algorithms.brax_training import (
    PPONetworkParams,
    RunningStatisticsState,
    Transition,
    compute_ppo_loss,
)
from core.algorithms.ppo.spec import PPOSpec


@struct.dataclass
class Hyperparameters:
    """The numbers that may change without recompiling; [] float32 each, infinite where a bound is not set.

    num_updates: of the whole run. Everything else is compiled in.
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
    num_updates: jax.Array

    @classmethod
    def of(cls, settings: PPOSpec) -> "Hyperparameters":
        keywords = {name: getattr(settings, name) for name in settings.arguments}
        numbers = {**keywords, "num_updates": settings.num_updates}
        return cls(
            **{name: jnp.float32(jnp.inf if value is None else value) for name, value in numbers.items()}
        )


Loss = Callable[[PPONetworkParams, Transition, jax.Array], tuple[jax.Array, dict[str, jax.Array]]]


def loss_of(
    settings: PPOSpec, networks: Any, normalizer: RunningStatisticsState, hyperparameters: Hyperparameters
) -> Loss:
    """(parameters, minibatch [unrolls, unroll_length, ...], key) -> (loss [], its parts by Brax's names).

    networks: do not normalise, because that is done once for the batch, not in every minibatch.
    Source: Schulman et al., Proximal Policy Optimization Algorithms (2017), eq. 9.
    """
    clips_values = settings.clipping_epsilon_value is not None
    bound = hyperparameters.clipping_epsilon_value if clips_values else None

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
            normalize_advantage=settings.normalize_advantage,
            vf_coefficient=hyperparameters.vf_loss_coefficient,  # pyright: ignore[reportArgumentType]
            clipping_epsilon_value=bound,  # pyright: ignore[reportArgumentType]
        )

    return loss


ADAM = optax.scale_by_adam()


def clipped(gradient: Any, bound: jax.Array) -> tuple[Any, jax.Array]:
    """The gradient scaled to a norm of at most `bound` [], and its norm [] before."""
    norm = optax.tree.norm(gradient)
    return jax.tree.map(lambda g: jnp.where(norm < bound, g, g / norm * bound), gradient), norm


def descend(
    params: Any, optimizer: optax.ScaleByAdamState, gradient: Any, learning_rate: jax.Array
) -> tuple[Any, optax.ScaleByAdamState]:
    """The next parameters and the next state of Adam."""
    direction, after = ADAM.update(gradient, optimizer)
    moved = jax.tree.map(lambda p, d: p - learning_rate * d, params, direction)
    return moved, cast("optax.ScaleByAdamState", after)


def adapt_to_kl(
    learning_rate: jax.Array, kl_mean: jax.Array, desired_kl: jax.Array, bounds: tuple[jax.Array, jax.Array]
) -> jax.Array:
    """The next learning rate []: divided by 1.5 if the policy moved too far, times 1.5 if it hardly moved.

    kl_mean: [], the mean divergence of the policy from the one that acted. Too far is more than twice
    `desired_kl`; hardly is less than half of it, but above 0. bounds: lowest and highest rate.
    Source: brax.training.agents.ppo.optimizer.adaptive_kl_learning_rate, after RSL-RL (Rudin et al., 2022).
    """
    lowest, highest = bounds
    slower = jnp.maximum(lowest, learning_rate / 1.5)
    faster = jnp.minimum(highest, learning_rate * 1.5)
    moved_too_far = kl_mean > 2 * desired_kl
    hardly_moved = (kl_mean > 0) & (kl_mean < desired_kl / 2)
    return jnp.where(moved_too_far, slower, jnp.where(hardly_moved, faster, learning_rate))


def linear(
    learning_rate: jax.Array, num_updates: jax.Array, budget: jax.Array, lowest: jax.Array
) -> jax.Array:
    """The learning rate [] after so many updates: a line to 0 at the budget's end, but not below `lowest`.

    budget: the updates of the whole run. Source: PPO's α in Schulman et al., Proximal Policy Optimization
    Algorithms, 2017, Table 5.
    """
    return jnp.maximum(lowest, learning_rate * (1.0 - num_updates / budget))
