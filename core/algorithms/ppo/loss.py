"""PPO's loss, a bounded step of Adam along its gradient, and learning-rate schedules.

On a GPU a gradient step on small networks is a chain of kernels that each take longer to begin than to
compute. So the loss is Brax's (brax.training.agents.ppo.losses) in fewer of them: one pass of the value
network, and no loop over time. Its numbers are Brax's but for rounding.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from core.algorithms.brax_training import (
    PPONetworkParams,
    RunningStatisticsState,
    Transition,
)
from core.algorithms.ppo.intention import LATENT_METRICS, IntentionPolicy, Latent
from core.algorithms.ppo.spec import PPOSpec

_OF_ENCODERS = ("kl_weight", "kl_ramp_steps", "smoothness_weight")


@struct.dataclass
class Hyperparameters:
    """The numbers that may change without recompiling; [] float32 each, infinite where a bound is not set.

    num_updates: of the whole run. kl_weight, kl_ramp_steps, smoothness_weight: of an encoder; 0 without one.
    Everything else is compiled in.
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
    kl_weight: jax.Array
    kl_ramp_steps: jax.Array
    smoothness_weight: jax.Array

    @classmethod
    def of(cls, settings: PPOSpec) -> "Hyperparameters":
        keywords = {name: getattr(settings, name) for name in settings.arguments}
        network = settings.network
        of_encoder = {name: 0.0 if network is None else getattr(network, name) for name in _OF_ENCODERS}
        numbers = {**keywords, **of_encoder, "num_updates": settings.num_updates}
        return cls(
            **{name: jnp.float32(jnp.inf if value is None else value) for name, value in numbers.items()}
        )


# The parts of the loss, by Brax's names, in the order in which kernels write them.
METRICS = (
    "total_loss",
    "policy_loss",
    "v_loss",
    "entropy_loss",
    "kl_mean",
    "policy_dist_mean_std",
    "policy_dist_mean_loc",
    "policy_dist_max_std",
    "policy_dist_max_loc",
    "policy_dist_min_std",
    "policy_dist_min_loc",
)
_STEPS_WITHOUT_A_LOOP = 16

Loss = Callable[[PPONetworkParams, Transition, jax.Array], tuple[jax.Array, dict[str, jax.Array]]]


def loss_of(
    settings: PPOSpec, networks: Any, normalizer: RunningStatisticsState, hyperparameters: Hyperparameters
) -> Loss:
    """(parameters, minibatch [unrolls, unroll_length, ...], key) -> (loss [], its parts by Brax's names).

    Where the policy has an encoder, the loss has two more parts, of z, and there are `LATENT_METRICS`.
    networks: do not normalise, because that is done once for the batch, not in every minibatch.
    Source: Schulman et al., Proximal Policy Optimization Algorithms (2017), eq. 9.
    """
    distribution = networks.parametric_action_distribution
    costs = hyperparameters

    def loss(params: PPONetworkParams, minibatch: Transition, key: jax.Array) -> Any:
        data = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), minibatch)  # time first
        extras = data.extras
        acted, truncation = extras["policy_extras"], extras["state_extras"]["truncation"]
        # The normaliser is not used: these networks do not normalise.
        latent: Latent | None = None
        if isinstance(networks.policy_network, IntentionPolicy):
            latent = networks.policy_network.encode(normalizer, params.policy, data.observation)
            z = latent.sample(acted["latent_noise"])
            logits = networks.policy_network.decode(params.policy, z, latent.body)
        else:
            logits = networks.policy_network.apply(normalizer, params.policy, data.observation)
        seen = jax.tree.map(
            lambda x, after: jnp.concatenate([x, after[-1:]]), data.observation, data.next_observation
        )
        values = networks.value_network.apply(normalizer, params.value, seen)
        returns, advantages = estimated(
            data.reward * costs.reward_scaling,
            jax.lax.stop_gradient(values),
            continues=costs.discounting * (1 - (1 - data.discount) * (1 - truncation)),
            counts=1 - truncation,
            gae_lambda=costs.gae_lambda,
        )
        if settings.normalize_advantage:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        log_prob = distribution.log_prob(logits, acted["raw_action"])
        ratio = jnp.exp(log_prob - acted["log_prob"])
        bounded = jnp.clip(ratio, 1 - costs.clipping_epsilon, 1 + costs.clipping_epsilon)
        policy_loss = -jnp.mean(jnp.minimum(ratio * advantages, bounded * advantages))
        errors = jnp.square(returns - values[:-1])
        if settings.clipping_epsilon_value is not None:
            bound, before = costs.clipping_epsilon_value, acted["value"]
            moved = before + jnp.clip(values[:-1] - before, -bound, bound)
            errors = jnp.maximum(errors, jnp.square(returns - moved))
        v_loss = jnp.mean(errors) * 0.5 * costs.vf_loss_coefficient
        entropy_loss = costs.entropy_cost * -jnp.mean(distribution.entropy(logits, key))
        total = policy_loss + v_loss + entropy_loss
        of_latent: dict[str, jax.Array] = {}
        if latent is not None:
            divergence = jnp.mean(latent.divergence)
            moved = latent.step(data.discount * (1 - truncation))
            total += costs.kl_weight * divergence + costs.smoothness_weight * moved
            values = (divergence, jnp.mean(jnp.exp(latent.log_std)), moved, costs.kl_weight)
            of_latent = dict(zip(LATENT_METRICS, values, strict=True))
        now, then = (distribution.create_dist(x) for x in (logits, acted["distribution_params"]))
        parts = (total, policy_loss, v_loss, entropy_loss, jnp.mean(now.kl_divergence(then)))
        described = (of(x) for of in (jnp.mean, jnp.max, jnp.min) for x in (now.scale, now.loc))
        return total, dict(zip(METRICS, (*parts, *described), strict=True)) | of_latent

    return loss


def estimated(
    rewards: jax.Array,
    values: jax.Array,
    *,
    continues: jax.Array,
    counts: jax.Array,
    gae_lambda: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """The returns that values are to have, and the generalised advantages; [T, B].

    rewards: [T, B]; values: [T + 1, B], the last of what is seen after the unroll. continues: [T, B], γ, or 0
    where the episode terminated. counts: [T, B], 0 where it was cut off, 1 elsewhere.
    Source: Schulman et al., High-Dimensional Continuous Control Using Generalised Advantage Estimation
    (2016), eq. 16; Brax's advantages are those of the λ-return after one more step.
    """

    def back(weighted: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        error, decay = step
        weighted = error + decay * weighted
        return weighted, weighted

    errors = (rewards + continues * values[1:] - values[:-1]) * counts
    decays = continues * counts * gae_lambda
    _, weighted = jax.lax.scan(
        back, jnp.zeros_like(values[-1]), (errors, decays), reverse=True, unroll=_STEPS_WITHOUT_A_LOOP
    )
    returns = weighted + values[:-1]
    afterwards = jnp.concatenate([returns[1:], values[-1:]])
    return returns, (rewards + continues * afterwards - values[:-1]) * counts


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


def ramped(
    hyperparameters: Hyperparameters, num_updates: jax.Array, steps_per_update: int
) -> Hyperparameters:
    """With the weight of z's divergence after so many updates: a line from 0 over `kl_ramp_steps`."""
    steps = num_updates.astype(jnp.float32) * steps_per_update
    share = jnp.minimum(steps / jnp.maximum(hyperparameters.kl_ramp_steps, 1.0), 1.0)
    share = jnp.where(hyperparameters.kl_ramp_steps > 0, share, 1.0)
    return replace(hyperparameters, kl_weight=hyperparameters.kl_weight * share)
