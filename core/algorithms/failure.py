"""Whether an update gave a value that is not finite, and where."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from core.algorithms.algorithm import Failure
from core.algorithms.experience import Outcome, lost_too_many


def find_failure(next_observation: Any, outcome: Outcome, learnt: Sequence[jax.Array]) -> Failure:
    """Which quantities of an update were not finite. Each may spoil those after it.

    next_observation: arrays [T, N, size]. learnt: for each further quantity, [] bool, true where it is not
    finite.
    """
    seen = [jnp.all(jnp.isfinite(x), axis=(1, 2)) for x in jax.tree.leaves(next_observation)]
    bad_obs = ~jnp.all(jnp.stack(seen), axis=0) | lost_too_many(outcome)
    bad_reward = ~jnp.all(jnp.isfinite(outcome.reward), axis=1)
    bad = bad_obs | bad_reward
    first = jnp.where(jnp.any(bad), jnp.argmax(bad), len(bad)).astype(jnp.int32)
    return Failure(jnp.stack([jnp.any(bad_obs), jnp.any(bad_reward), *learnt]), first)


def any_not_finite(tree: Any) -> jax.Array:
    """[] bool, of all arrays of a tree."""
    return jnp.any(jnp.stack([~jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))
