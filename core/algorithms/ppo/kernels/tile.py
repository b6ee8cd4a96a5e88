"""The computations of one block of threads on a tile of samples: networks, and the policy's loss.

Everything here runs inside a kernel, on arrays whose sides are powers of two; JAX differentiates it there.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from core.algorithms.ppo.kernels.layout import rounded_up
from core.algorithms.ppo.kernels.sizes import Sizes

_MIN_STD = 0.001  # Brax's NormalTanhDistribution
_LOG_2, _HALF_LOG_2_PI = 0.6931471805599453, 0.9189385332046727


class Tile(NamedTuple):
    """A tile's inputs to the policy's loss: observations [rows, obs]; the action before tanh, the mean and
    raw deviation that it was drawn from, and noise [rows, act]; log-probability and advantage [rows]."""

    seen: jax.Array
    taken: jax.Array
    old_mean: jax.Array
    old_raw: jax.Array
    noise: jax.Array
    old_log_prob: jax.Array
    advantage: jax.Array


def policy_loss(
    sizes: Sizes, tile: Tile, costs: tuple[jax.Array, jax.Array], weights: Any
) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """A tile's share of the policy's loss with its entropy; the sums and largest values for the metrics.

    costs: the clipping ε, and what entropy is worth.
    """
    (clipping_epsilon, entropy_cost), taken = costs, tile.taken
    real = across(sizes) < sizes.action_size

    def added(x: jax.Array) -> jax.Array:
        return jnp.sum(jnp.where(real, x, 0.0), axis=1)

    *hidden, means, deviations = weights
    h = _hidden(sizes, hidden, tile.seen)
    mean = jnp.dot(h, means[0]) + means[1][None, :]
    std = _softplus(jnp.dot(h, deviations[0]) + deviations[1][None, :]) + _MIN_STD
    old_std = _softplus(tile.old_raw) + _MIN_STD
    off = (taken - mean) / std
    log_prob = added(-0.5 * off * off - jnp.log(std) - _HALF_LOG_2_PI - _log_det_tanh(taken))
    ratio = jnp.exp(log_prob - tile.old_log_prob)
    low, high = 1 - clipping_epsilon, 1 + clipping_epsilon
    gain = jnp.minimum(ratio * tile.advantage, jnp.minimum(jnp.maximum(ratio, low), high) * tile.advantage)
    entropy = added(0.5 + _HALF_LOG_2_PI + jnp.log(std) + _log_det_tanh(tile.noise * std + mean))
    moved = tile.old_mean - mean
    kl = added(jnp.log(std / old_std + 1e-5) + (old_std * old_std + moved * moved) / (2.0 * std * std) - 0.5)
    of_policy, of_entropy = -jnp.sum(gain), jnp.sum(entropy)
    lowest = jnp.float32(-3e38)
    sums = (of_policy, of_entropy, jnp.sum(kl), jnp.sum(added(std)), jnp.sum(added(mean)))
    largest = tuple(jnp.max(jnp.max(jnp.where(real, x, lowest), axis=1)) for x in (std, mean, -std, -mean))
    loss = (of_policy - entropy_cost * of_entropy) / sizes.samples
    return loss, jax.lax.stop_gradient((*sums, *largest))


def _hidden(sizes: Sizes, weights: Any, seen: jax.Array) -> jax.Array:
    h = seen
    for kernel, bias in weights:
        h = sizes.activation(jnp.dot(h, kernel) + bias[None, :])
    return h


def value(sizes: Sizes, weights: Any, seen: jax.Array) -> jax.Array:
    """[rows]. The last layer is padded to 16 columns, of which the first is the value."""
    *hidden, (kernel, bias) = weights
    out = jnp.dot(_hidden(sizes, hidden, seen), kernel) + bias[None, :]
    return jnp.sum(jnp.where(jnp.arange(out.shape[1])[None, :] == 0, out, 0.0), axis=1)


def across(sizes: Sizes) -> jax.Array:
    return jnp.arange(rounded_up(sizes.action_size))[None, :]


def _softplus(x: jax.Array) -> jax.Array:
    return jnp.maximum(x, 0.0) + jnp.log1p(jnp.exp(-jnp.abs(x)))


def _log_det_tanh(x: jax.Array) -> jax.Array:
    """The logarithm of the derivative of tanh."""
    return 2.0 * (_LOG_2 - x - _softplus(-2.0 * x))
