"""What a body can earn: one pure function for each kind of reward term. Weights are applied elsewhere.

Names and forms are those common to locomotion tasks: Brax's and Gymnasium's bodies (forward velocity, alive,
control cost), legged_gym and MuJoCo Playground (velocity tracking, action rate, energy, joint limits).
"""

import jax
import jax.numpy as jnp

from core.environments.body import height_is_healthy


def forward_velocity(before: jax.Array, after: jax.Array, direction: jax.Array, dt: float) -> jax.Array:
    """d · (p' − p) / dt in m/s. before p, after p', direction d of length 1: [3]. Returns []."""
    return jnp.dot((after - before) / dt, direction)


def velocity_tracking(velocity: jax.Array, wanted: jax.Array, tolerance: float) -> jax.Array:
    """exp(−‖v − v*‖² / σ²), in (0, 1]. velocity v, wanted v*: [2] in m/s; tolerance σ in m/s. Returns []."""
    return jnp.exp(-jnp.sum(jnp.square(velocity - wanted)) / tolerance**2)


def upright(rotation: jax.Array, axis: jax.Array) -> jax.Array:
    """(R a)_z, the cosine of the axis' angle to the vertical. rotation R: [3, 3]; axis a of length 1: [3]."""
    return jnp.dot(rotation[2], axis)


def height_range(height: jax.Array, bounds: tuple[float, float]) -> jax.Array:
    """1 where low ≤ z ≤ high, otherwise 0. height z: [] in m."""
    return height_is_healthy(height, bounds)


def control_cost(action: jax.Array) -> jax.Array:
    """Σ a². action a: [nu], each in [-1, 1]. Returns []."""
    return jnp.sum(jnp.square(action))


def energy(force: jax.Array, velocity: jax.Array) -> jax.Array:
    """Σ |τ q̇| in W. force τ: the actuators' on each degree of freedom, velocity q̇: [nv]. Returns []."""
    return jnp.sum(jnp.abs(force * velocity))


def action_rate(action: jax.Array, previous_action: jax.Array) -> jax.Array:
    """Σ (aₜ − aₜ₋₁)². Both [nu]. Returns []."""
    return jnp.sum(jnp.square(action - previous_action))


def distance(position: jax.Array, target: jax.Array) -> jax.Array:
    """‖p − p*‖ in m. position p, target p*: [3]. Returns []."""
    return jnp.linalg.norm(position - target)


def joint_limits(position: jax.Array, low: jax.Array, high: jax.Array, share: float) -> jax.Array:
    """Σ max(0, |q − m| − s h) in rad or m, with m the middle of a joint's range and h half of its width.

    position q, low, high: [joints]; share s: of the range, free of cost. Returns [].
    """
    middle, half = (low + high) / 2, (high - low) / 2
    return jnp.sum(jnp.maximum(0.0, jnp.abs(position - middle) - share * half))


def contact(num_found: jax.Array) -> jax.Array:
    """How many of the geoms touch. num_found: [geoms], contacts that each has. Returns []."""
    return jnp.sum(jnp.where(num_found > 0, 1.0, 0.0))
