"""Reward and termination terms: pure functions; the environments weight them, and `total` adds them up.

The built-in environments use them; those of a job that is made of terms have their formulas in
`core.environments.terms`.
"""

import operator
from collections.abc import Mapping
from functools import reduce

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


def total(rewards: Mapping[str, Scalar]) -> Scalar:
    """The reward of a step: its weighted terms, of which costs are negative, added from first to last.

    rewards: [] by name, at least one. Returns [].
    """
    return reduce(operator.add, rewards.values())


def velocity(
    before: Float[Array, "*shape"], after: Float[Array, "*shape"], dt: float
) -> Float[Array, "*shape"]:
    """(p' − p) / dt in m/s. before p, after p': in metres, of any shape; the result has the same."""
    return (after - before) / dt


def linear_tolerance(value: Scalar, target: float | Scalar, margin: float | Scalar) -> Scalar:
    """max(0, 1 − |x − x*| / m): 1 at the target x*, 0 where it is the margin m > 0 or more away. Returns [].

    value x, target, margin: [] in one unit. Source: dm_control's `rewards.tolerance` with both bounds at the
    target and a linear sigmoid that is 0 at the margin, as its `RunThroughCorridor` calls it.
    """
    return jnp.maximum(0.0, 1.0 - jnp.abs(value - target) / margin)


def upright(rotation: Float[Array, "3 3"], axis: Float[Array, "3"]) -> Scalar:
    """(R a)_z, the cosine of the axis' angle to the vertical. rotation R: [3, 3]; axis a of length 1: [3]."""
    return jnp.dot(rotation[2], axis)


def height_range(height: Scalar, bounds: tuple[float, float]) -> Scalar:
    """1 where low ≤ z ≤ high, otherwise 0; 1 also for NaN. height z: [] in m. Returns []."""
    low, high = bounds
    return jnp.where((height < low) | (height > high), 0.0, 1.0)


def survival(healthy: Scalar, *, terminates: bool) -> tuple[Scalar, Scalar]:
    """Whether a step earns the reward for being healthy, and whether it ends the episode: [], 1 or 0 each.

    If being unhealthy ends the episode, the step that ends it still earns the reward (as in Brax);
    otherwise an unhealthy step earns none. healthy: [], 1 or 0.
    """
    return (jnp.ones(()), 1.0 - healthy) if terminates else (healthy, jnp.zeros(()))


def control_cost(action: Float[Array, " nu"]) -> Scalar:
    """Σ a². action a: [nu], each in [-1, 1]. Returns []."""
    return jnp.sum(jnp.square(action))


def distance(position: Float[Array, " axes"], target: Float[Array, " axes"]) -> Scalar:
    """‖p − p*‖ in m. position p, target p*: [axes]. Returns []."""
    return jnp.linalg.norm(position - target)
