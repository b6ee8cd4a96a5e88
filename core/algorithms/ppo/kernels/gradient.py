"""The gradient of PPO's loss on one minibatch, in three kernels for a GPU instead of a hundred.

A gradient step on small networks is a chain of kernels that each take a few microseconds to begin. Here each
block of threads takes a tile of rows through a whole network and back, and JAX differentiates what it does.

Source of the loss: Schulman et al., Proximal Policy Optimization Algorithms (2017), eq. 9, with Brax's
estimate of advantages (brax.training.agents.ppo.losses), whose numbers these are except for rounding.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton as plgpu

from core.algorithms.ppo.kernels.layout import KernelLayer, KernelSizes, rounded_up

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
    sizes: KernelSizes, tile: Tile, costs: tuple[jax.Array, jax.Array], weights: Any
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


def _hidden(sizes: KernelSizes, weights: Any, seen: jax.Array) -> jax.Array:
    h = seen
    for kernel, bias in weights:
        h = sizes.activation(jnp.dot(h, kernel) + bias[None, :])
    return h


def value(sizes: KernelSizes, weights: Any, seen: jax.Array) -> jax.Array:
    """[rows]. The last layer is padded to 16 columns, of which the first is the value."""
    *hidden, (kernel, bias) = weights
    out = jnp.dot(_hidden(sizes, hidden, seen), kernel) + bias[None, :]
    return jnp.sum(jnp.where(jnp.arange(out.shape[1])[None, :] == 0, out, 0.0), axis=1)


def across(sizes: KernelSizes) -> jax.Array:
    return jnp.arange(rounded_up(sizes.action_size))[None, :]


def _softplus(x: jax.Array) -> jax.Array:
    return jnp.maximum(x, 0.0) + jnp.log1p(jnp.exp(-jnp.abs(x)))


def _log_det_tanh(x: jax.Array) -> jax.Array:
    """The logarithm of the derivative of tanh."""
    return 2.0 * (_LOG_2 - x - _softplus(-2.0 * x))


# The hyperparameters that the loss reads, in this order.
HYPERPARAMETERS = (
    "discounting",
    "gae_lambda",
    "reward_scaling",
    "clipping_epsilon",
    "entropy_cost",
    "vf_loss_coefficient",
)
# A tile's numbers for the metrics: six sums, then four largest values; the rest is padding.
_NUM_SUMS, _NUM_LARGEST, _TOLD_BY_A_TILE = 6, 4, 16
_NUM_WARPS = 4


class Batch(NamedTuple):
    """An update's unrolls [U], flattened, for the kernels to pick from.

    observation: [U, T + 1, rounded obs], the last that after the unroll. action: [U, T, 3, rounded act]: the
    action before tanh, the mean and the raw deviation that it was drawn from. told: [U, T, 4]: reward,
    discount, truncation, log-probability.
    """

    observation: jax.Array
    action: jax.Array
    told: jax.Array


class Chosen(NamedTuple):
    """A minibatch. order: [minibatches * B] int32, the unrolls in the order of a pass. which: [1] int32, the
    minibatch. noise: [U, T, rounded act], standard normal, from which the entropy is estimated."""

    order: jax.Array
    which: jax.Array
    noise: jax.Array


def gradient(
    sizes: KernelSizes, params: jax.Array, batch: Batch, chosen: Chosen, hyper: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The loss's gradient [P] by the packed parameters [P], and the loss's parts [11], see `loss.METRICS`.

    hyper: [6], see HYPERPARAMETERS.
    """
    arrays = {"params": params, **batch._asdict(), **chosen._asdict(), "hyper": hyper}
    arrays = {name: array.ravel() for name, array in arrays.items()}
    samples, blocks, tiles = sizes.samples, sizes.num_blocks, sizes.num_tiles
    lengths = {"values": samples + sizes.batch_size}
    arrays |= _call(_values, sizes, (tiles + blocks,), arrays, lengths)
    lengths = {"returns": samples, "advantages": samples, "sums": 2 * blocks}
    arrays |= _call(_advantages, sizes, (blocks,), arrays, lengths)
    lengths = {"gradients": tiles * sizes.layout.size, "metrics": tiles * _TOLD_BY_A_TILE}
    found = _call(_gradients, sizes, (2, tiles), arrays, lengths)
    summed = jnp.sum(found["gradients"].reshape(tiles, -1), axis=0)
    return summed, _named(sizes, found["metrics"].reshape(tiles, -1), hyper)


def _call(
    kernel: Callable[[KernelSizes, Any], None],
    sizes: KernelSizes,
    grid: tuple[int, ...],
    arrays: Mapping[str, jax.Array],
    lengths: Mapping[str, int],
) -> dict[str, jax.Array]:
    """Run the kernel; returns its outputs by name. It gets all arrays, flat, as attributes of one object."""
    names = [*arrays, *lengths]

    def body(*refs: Any) -> None:
        kernel(sizes, SimpleNamespace(**dict(zip(names, refs, strict=True))))

    call = pl.pallas_call(
        body,
        out_shape=[jax.ShapeDtypeStruct((length,), jnp.float32) for length in lengths.values()],
        grid=grid,
        compiler_params=plgpu.CompilerParams(num_warps=_NUM_WARPS, num_stages=1),
        interpret=sizes.interpret,
        name=f"ppo{kernel.__name__}",
    )
    return dict(zip(lengths, call(*arrays.values()), strict=True))


def _values(sizes: KernelSizes, refs: Any) -> None:
    """The values [T + 1, B] of every observation."""
    time, unrolls, at = _tile(sizes, refs, pl.program_id(0))
    seen = _observed(sizes, refs, unrolls, time)
    refs.values[at] = value(sizes, _weights(refs, sizes.layout.value), seen)


def _advantages(sizes: KernelSizes, refs: Any) -> None:
    """Generalised advantages [T, B], and the returns [T, B] that values are to have.

    Source: Schulman et al., High-Dimensional Continuous Control Using Generalised Advantage Estimation
    (2016).
    """
    block = pl.program_id(0)
    columns = block * sizes.rows + jnp.arange(sizes.rows)
    unrolls = refs.order[refs.which[0] * sizes.batch_size + columns]
    discounting, gae_lambda, scaling = refs.hyper[0], refs.hyper[1], refs.hyper[2]

    def back(step: Any, carry: Any) -> Any:
        weighted, next_return, next_value, mean, squares = carry
        time = sizes.unroll_length - 1 - step
        at = time * sizes.batch_size + columns
        of_step = (unrolls * sizes.unroll_length + time) * 4
        reward, discount, truncation = (refs.told[of_step + index] for index in range(3))
        goes_on = discounting * (1 - (1 - discount) * (1 - truncation))
        counts = 1 - truncation
        said = refs.values[at]
        error = (reward * scaling + goes_on * next_value - said) * counts
        weighted = error + goes_on * counts * gae_lambda * weighted
        wanted = weighted + said
        advantage = (reward * scaling + goes_on * next_return - said) * counts
        refs.returns[at] = wanted
        refs.advantages[at] = advantage
        # Welford (1962): a mean of squares less a squared mean has no digits left where rewards are large.
        away = advantage - mean
        mean += away / (step + 1).astype(jnp.float32)
        return weighted, wanted, said, mean, squares + away * (advantage - mean)

    last = refs.values[sizes.samples + columns]
    start = (jnp.zeros_like(last), last, last, jnp.zeros_like(last), jnp.zeros_like(last))
    *_, mean, squares = jax.lax.fori_loop(0, sizes.unroll_length, back, start)
    of_block = jnp.sum(mean) / sizes.rows
    away = mean - of_block
    refs.sums[2 * block] = of_block
    refs.sums[2 * block + 1] = jnp.sum(squares + sizes.unroll_length * away * away)


def _gradients(sizes: KernelSizes, refs: Any) -> None:
    """The contribution of each tile to the gradient [tiles, P] and to the metrics [tiles, 16].

    Half of the blocks differentiate the policy's loss, and half that of the value network.
    """
    number = pl.program_id(1)
    time, unrolls, at = _tile(sizes, refs, number)
    seen = _observed(sizes, refs, unrolls, time)
    layers, told = sizes.layout, number * _TOLD_BY_A_TILE

    def store(of_layers: Sequence[KernelLayer], found: Any) -> None:
        for layer, (kernel, bias) in zip(of_layers, found, strict=True):
            start = number * layers.size
            refs.gradients[start + layer.start + _places(layer)] = kernel
            refs.gradients[start + layer.bias + jnp.arange(layer.columns)] = bias

    @pl.when(pl.program_id(0) == 0)
    def _() -> None:
        row = unrolls * sizes.unroll_length + time
        width, columns = rounded_up(sizes.action_size), across(sizes)
        tile = Tile(
            seen,
            taken=refs.action[(row * 3)[:, None] * width + columns],
            old_mean=refs.action[(row * 3 + 1)[:, None] * width + columns],
            old_raw=refs.action[(row * 3 + 2)[:, None] * width + columns],
            noise=refs.noise[row[:, None] * width + columns],
            old_log_prob=refs.told[row * 4 + 3],
            advantage=_normalised(sizes, refs.advantages[at], refs.sums),
        )
        loss = partial(policy_loss, sizes, tile, (refs.hyper[3], refs.hyper[4]))
        found, parts = jax.grad(loss, has_aux=True)(_weights(refs, layers.policy))
        store(layers.policy, found)
        for index, part in enumerate(parts):
            refs.metrics[told + 1 + index] = part

    @pl.when(pl.program_id(0) == 1)
    def _() -> None:
        wanted, scale = refs.returns[at], 0.5 * refs.hyper[5] / sizes.samples

        def loss(weights: Any) -> jax.Array:
            error = wanted - value(sizes, weights, seen)
            return jnp.sum(error * error) * scale

        part, found = jax.value_and_grad(loss)(_weights(refs, layers.value))
        store(layers.value, found)
        refs.metrics[told] = part


def _named(sizes: KernelSizes, of_tiles: jax.Array, hyper: jax.Array) -> jax.Array:
    """[11], see `loss.METRICS`. of_tiles: [tiles, 16]."""
    sums = jnp.sum(of_tiles[:, :_NUM_SUMS], axis=0)
    largest = jnp.max(of_tiles[:, _NUM_SUMS : _NUM_SUMS + _NUM_LARGEST], axis=0)
    num_numbers = sizes.samples * sizes.action_size
    scales = [1.0, 1 / sizes.samples, 0.0, 1 / sizes.samples, 1 / num_numbers, 1 / num_numbers]
    v_loss, policy_loss, _, kl, std, loc = jnp.split(sums * jnp.array(scales), _NUM_SUMS)
    entropy_loss = -hyper[4:5] * sums[2:3] / sizes.samples
    signed = largest * jnp.array([1.0, 1.0, -1.0, -1.0])
    total = policy_loss + v_loss + entropy_loss
    return jnp.concatenate([total, policy_loss, v_loss, entropy_loss, kl, std, loc, signed])


def _tile(sizes: KernelSizes, refs: Any, number: Any) -> tuple[Any, Any, Any]:
    """A tile's time, its unrolls [rows], and where its samples lie in arrays [T, B]."""
    time = number // sizes.num_blocks
    columns = (number % sizes.num_blocks) * sizes.rows + jnp.arange(sizes.rows)
    return time, refs.order[refs.which[0] * sizes.batch_size + columns], time * sizes.batch_size + columns


def _observed(sizes: KernelSizes, refs: Any, unrolls: Any, time: Any) -> jax.Array:
    width = sizes.layout.value[0].rows
    rows = unrolls * (sizes.unroll_length + 1) + time
    return refs.observation[rows[:, None] * width + jnp.arange(width)[None, :]]


def _weights(refs: Any, layers: Sequence[KernelLayer]) -> list[tuple[jax.Array, jax.Array]]:
    """Kernels and biases of a network."""
    return [
        (refs.params[layer.start + _places(layer)], refs.params[layer.bias + jnp.arange(layer.columns)])
        for layer in layers
    ]


def _places(layer: KernelLayer) -> jax.Array:
    return jnp.arange(layer.rows)[:, None] * layer.columns + jnp.arange(layer.columns)[None, :]


def _normalised(sizes: KernelSizes, advantage: jax.Array, sums: Any) -> jax.Array:
    """Mean 0 and deviation 1 over the minibatch."""
    means = [sums[2 * block] for block in range(sizes.num_blocks)]
    mean = sum(means, jnp.float32(0)) / sizes.num_blocks
    of_each = sizes.samples // sizes.num_blocks
    squares = jnp.float32(0)
    for block, own in enumerate(means):
        squares += sums[2 * block + 1] + of_each * (own - mean) * (own - mean)
    variance = squares / sizes.samples
    return (advantage - mean) / (jnp.sqrt(variance) + 1e-8)
