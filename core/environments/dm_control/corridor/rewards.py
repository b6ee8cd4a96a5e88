"""Terms of the corridor's reward and end; others have theirs in `core.environments.terms`."""

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


def linear_tolerance(value: Scalar, target: float | Scalar, margin: float | Scalar) -> Scalar:
    """max(0, 1 − |x − x*| / m): 1 at the target x*, 0 where it is the margin m > 0 or more away. Returns [].

    value x, target, margin: [] in one unit. Source: dm_control's `rewards.tolerance` with both bounds at the
    target and a linear sigmoid that is 0 at the margin, as its `RunThroughCorridor` calls it.
    """
    return jnp.maximum(0.0, 1.0 - jnp.abs(value - target) / margin)


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
