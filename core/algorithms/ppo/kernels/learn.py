"""The passes over a batch by the kernels of `gradient`, where `layout.fits` says that they can."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import optax

from core.algorithms.brax_training import PPONetworkParams, Transition
from core.algorithms.brax_training import networks as brax_networks
from core.algorithms.ppo.kernels.gradient import HYPERPARAMETERS, Batch, Chosen, gradient
from core.algorithms.ppo.kernels.layout import KernelLayout, KernelSizes, rounded_up
from core.algorithms.ppo.loss import METRICS, Hyperparameters, clipped, descend
from core.algorithms.ppo.spec import PPOSpec

Learnt = tuple[PPONetworkParams, optax.ScaleByAdamState]


def learn(
    settings: PPOSpec,
    learnt: Learnt,
    batch: Transition,
    hyperparameters: Hyperparameters,
    key: jax.Array,
    *,
    interpret: bool = False,
) -> tuple[Learnt, dict[str, jax.Array]]:
    """Parameters and optimiser after the passes over a batch [unrolls, unroll_length, ...] of normalised
    observations, and means of the losses. interpret: run the kernels without a GPU, slowly."""
    params, optimizer = learnt
    sizes = _sizes(settings, batch, interpret=interpret)
    layout, num_unrolls = sizes.layout, settings.batch_size * settings.num_minibatches
    flat, width = _flattened(batch), rounded_up(sizes.action_size)
    hyper = jnp.stack([getattr(hyperparameters, name) for name in HYPERPARAMETERS])
    which = jnp.arange(settings.num_minibatches, dtype=jnp.int32)[:, None]

    def drawn(key: jax.Array) -> tuple[jax.Array, jax.Array]:
        order_key, loss_key = jax.random.split(key)
        order = jax.random.permutation(order_key, num_unrolls).astype(jnp.int32)
        return order, jax.random.normal(loss_key, (*batch.reward.shape, width))

    def learn_pass(carry: Any, batch_and_key: tuple[jax.Array, jax.Array]) -> tuple[Any, Any]:
        order, noise = batch_and_key

        def learn_minibatch(carry: Any, which: jax.Array) -> tuple[Any, Any]:
            vector, optimizer = carry
            found, metrics = gradient(sizes, vector, flat, Chosen(order, which, noise), hyper)
            found, norm = clipped(found, hyperparameters.max_grad_norm)
            return descend(vector, optimizer, found, hyperparameters.learning_rate), jnp.append(metrics, norm)

        return jax.lax.scan(learn_minibatch, carry, which)

    packed = optimizer._replace(mu=layout.pack(optimizer.mu), nu=layout.pack(optimizer.nu))
    # The passes' orders are sorted side by side.
    passes = jax.vmap(drawn)(jax.random.split(key, settings.num_updates_per_batch))
    (vector, packed), metrics = jax.lax.scan(learn_pass, (layout.pack(params), packed), passes)
    moments = {name: layout.unpack(getattr(packed, name), params) for name in ("mu", "nu")}
    unpacked = (layout.unpack(vector, params), packed._replace(**moments))
    means = jnp.mean(metrics, axis=(0, 1))
    return unpacked, dict(zip((*METRICS, "grad_norm"), means, strict=True))


def _sizes(settings: PPOSpec, batch: Transition, *, interpret: bool) -> KernelSizes:
    extras: Any = batch.extras
    action_size = extras["policy_extras"]["raw_action"].shape[-1]
    hidden = settings.policy_hidden_layer_sizes, settings.value_hidden_layer_sizes
    return KernelSizes(
        KernelLayout.of(batch.observation.shape[-1], action_size, *hidden),
        cast("Any", brax_networks.ACTIVATION[settings.activation]),
        action_size,
        settings.unroll_length,
        settings.batch_size,
        interpret,
    )


def _flattened(batch: Transition) -> Batch:
    """The batch as flat arrays. Its bootstrap observation, [..., 1, obs], is appended to the unroll."""
    extras: Any = batch.extras
    acted, told = extras["policy_extras"], extras["state_extras"]
    seen = jnp.concatenate([batch.observation, batch.next_observation], axis=1)
    mean, deviation = jnp.split(acted["distribution_params"], 2, axis=-1)
    return Batch(
        _padded(seen),
        jnp.stack([_padded(x) for x in (acted["raw_action"], mean, deviation)], axis=2),
        jnp.stack([batch.reward, batch.discount, told["truncation"], acted["log_prob"]], axis=-1),
    )


def _padded(x: jax.Array) -> jax.Array:
    return jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, rounded_up(x.shape[-1]) - x.shape[-1])])
