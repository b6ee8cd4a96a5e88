"""What environments of other packages have in common: these bring reset and step of their own."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco


def plain_key(key: jax.Array) -> jax.Array:
    """The key as two numbers, as these packages have it: they keep it among their state's arrays."""
    return jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key


def as_float(value: Any) -> jax.Array:
    """float32, whether it was a number of Python's, a truth or an array: states keep their form."""
    return jnp.asarray(value).astype(jnp.float32)


def root_of(model: mujoco.MjModel) -> int:
    """The first body that can move: the one that the camera `track` follows."""
    return int(model.jnt_bodyid[0])
