"""Reward and termination terms: pure functions; the environments weight them, and `total` adds them up.

The built-in environments and those that a job makes of terms (`mjcf`) use the same functions. Names and forms
are common to locomotion tasks: Brax and Gymnasium (forward velocity, alive, control cost), legged_gym and
MuJoCo Playground (velocity tracking, action rate, energy, joint limits).
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


def forward_velocity(
    before: Float[Array, "3"], after: Float[Array, "3"], direction: Float[Array, "3"], dt: float
) -> Scalar:
    """d · (p' − p) / dt in m/s. before p, after p', direction d of length 1: [3]. Returns []."""
    return jnp.dot(velocity(before, after, dt), direction)


def velocity_tracking(moving: Float[Array, "2"], wanted: Float[Array, "2"], tolerance: float) -> Scalar:
    """exp(−‖v − v*‖² / σ²), in (0, 1]. moving v, wanted v*: [2] in m/s; tolerance σ in m/s. Returns []."""
    return jnp.exp(-jnp.sum(jnp.square(moving - wanted)) / tolerance**2)


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


def energy(force: Float[Array, " nv"], speed: Float[Array, " nv"]) -> Scalar:
    """Σ |τ q̇| in W. force τ: the actuators' on each degree of freedom, speed q̇: [nv]. Returns []."""
    return jnp.sum(jnp.abs(force * speed))


def action_rate(action: Float[Array, " nu"], previous_action: Float[Array, " nu"]) -> Scalar:
    """Σ (aₜ − aₜ₋₁)². Both [nu]. Returns []."""
    return jnp.sum(jnp.square(action - previous_action))


def distance(position: Float[Array, " axes"], target: Float[Array, " axes"]) -> Scalar:
    """‖p − p*‖ in m. position p, target p*: [axes]. Returns []."""
    return jnp.linalg.norm(position - target)


def joint_limits(
    position: Float[Array, " joints"],
    low: Float[Array, " joints"],
    high: Float[Array, " joints"],
    share: float,
) -> Scalar:
    """Σ max(0, |q − m| − s h) in rad or m, with m the middle of a joint's range and h half of its width.

    position q, low, high: [joints]; share s: the part of the range without cost. Returns [].
    """
    middle, half = (low + high) / 2, (high - low) / 2
    return jnp.sum(jnp.maximum(0.0, jnp.abs(position - middle) - share * half))


def contact(num_found: Float[Array, " geoms"]) -> Scalar:
    """How many of the geoms touch something. num_found: [geoms], contacts of each. Returns []."""
    return jnp.sum(jnp.where(num_found > 0, 1.0, 0.0))
