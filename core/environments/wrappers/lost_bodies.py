"""Bodies whose state is lost: an engine returned values that are not finite, or ran out of room for contacts.

MuJoCo Playground's environments end such an episode, too (`done |= jnp.isnan(data.qpos).any()`).
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from core.environments.environment import State
from core.environments.wrappers.autoreset import select


def without_lost(before: State, after: State) -> tuple[State, jax.Array]:
    """`after` [N, ...] a step, and which bodies it lost, [N] bool.

    A lost body keeps the state before the step, its episode ends, and its reward and metrics are 0. A
    reward that is not finite though the body's state is: that is the task's error, and it stays.
    """
    lost = ~_is_finite(after)
    at_rest = replace(
        after,
        physics=before.physics,
        obs=before.obs,
        info=before.info,
        reward=jnp.zeros_like(after.reward),
        done=jnp.ones_like(after.done),
        metrics=jax.tree.map(jnp.zeros_like, after.metrics),
    )
    return select(lost, at_rest, after), lost


def _is_finite(state: State) -> jax.Array:
    """[N] bool: whether positions, velocities and all that is observed are."""
    seen = [state.physics.qpos, state.physics.qvel, *jax.tree.leaves(state.obs)]
    return jnp.stack([jnp.isfinite(x).all(axis=tuple(range(1, x.ndim))) for x in seen]).all(axis=0)
