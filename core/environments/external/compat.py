"""The common part of environments of other packages, which bring their own reset and step."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco


def plain_key(key: jax.Array) -> jax.Array:
    """The key as two numbers, as these packages keep it among their state's arrays."""
    return jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key


def as_float(value: Any) -> jax.Array:
    """A Python number, a bool or an array as float32, so that states keep their types."""
    return jnp.asarray(value).astype(jnp.float32)


def root_of(model: mujoco.MjModel) -> int:
    """The first body that can move: the one that the camera `track` follows."""
    return int(model.jnt_bodyid[0])
