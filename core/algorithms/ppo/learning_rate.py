"""Learning rates that change while a run trains."""

import jax
import jax.numpy as jnp


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
