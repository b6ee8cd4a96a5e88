"""A step of Adam along a gradient whose norm is bounded, for parameters of any shape."""

from typing import Any, cast

import jax
import jax.numpy as jnp
import optax

ADAM = optax.scale_by_adam()


def clipped(gradient: Any, bound: jax.Array) -> tuple[Any, jax.Array]:
    """The gradient, no longer than `bound` [], and the norm [] that it had."""
    norm = optax.tree.norm(gradient)
    return jax.tree.map(lambda g: jnp.where(norm < bound, g, g / norm * bound), gradient), norm


def descend(
    params: Any, optimizer: optax.ScaleByAdamState, gradient: Any, learning_rate: jax.Array
) -> tuple[Any, optax.ScaleByAdamState]:
    """The next parameters and the next state of Adam."""
    direction, after = ADAM.update(gradient, optimizer)
    moved = jax.tree.map(lambda p, d: p - learning_rate * d, params, direction)
    return moved, cast("optax.ScaleByAdamState", after)
