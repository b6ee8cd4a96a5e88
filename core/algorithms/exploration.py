"""Choosing among a few actions by their values, and sometimes at random."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from core.algorithms.epsilon import Shape

Scalar = Float[Array, ""] | float


def greedy(values: Float[Array, "*N choices"]) -> Int[Array, "*N"]:
    """The best choices [...] int32 by their values, of equal ones the first."""
    return jnp.argmax(values, axis=-1).astype(jnp.int32)


def epsilon_greedy(values: Float[Array, "*N choices"], epsilon: Scalar, key: jax.Array) -> Int[Array, "*N"]:
    """The best choices [...] int32, but with probability epsilon [] any.

    Source: Sutton & Barto, Reinforcement Learning (2018), section 2.2.
    """
    explore_key, choose_key = jax.random.split(key)
    shape, num_choices = values.shape[:-1], values.shape[-1]
    explores = jax.random.uniform(explore_key, shape) < epsilon
    any_choice = jax.random.randint(choose_key, shape, 0, num_choices)
    return jnp.where(explores, any_choice, greedy(values))


def decayed(start: Scalar, end: Scalar, share: Scalar, shape: Shape) -> Float[Array, ""]:
    """Epsilon after this share of its decay, which ends at 1: from `start` to `end`."""
    share = jnp.clip(share, 0.0, 1.0)
    if shape == "linear":
        return start + (end - start) * share
    return start * (end / start) ** share
