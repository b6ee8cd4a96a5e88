"""Where the target lies, in as many directions as the star has arms."""

import jax
import jax.numpy as jnp

from core.environments.discretization import Discretization, Seen, StateDiscretizer

_NEEDS = ("disk_rotation", "xy_direction_to_target")


def towards_target(num_arms: int) -> Discretization:
    """arm_towards_target: one row, the arm in whose sector the target lies. arm_role, arm_side: a row for
    each arm."""
    arms = tuple(f"target: arm {arm}" for arm in range(num_arms))
    steps = ("target: this arm", *(f"target: {number} to the left" for number in range(1, num_arms)))
    sides = ("closest to the target", "on the left", "on the right", "opposite")[: num_sides(num_arms)]
    return Discretization(
        {
            "arm_towards_target": StateDiscretizer(
                _NEEDS, num_arms, 1, lambda seen: sector_of_target(seen, num_arms)[None], arms
            ),
            "arm_role": StateDiscretizer(
                _NEEDS, num_arms, num_arms, lambda seen: steps_to_target(seen, num_arms), steps
            ),
            "arm_side": StateDiscretizer(
                _NEEDS, len(sides), num_arms, lambda seen: sides_of_target(seen, num_arms), sides
            ),
        }
    )


def sector_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[] int32: the arm in whose sector the target lies.

    Arm k points at 2π k / num_arms from the disk's x axis, and its sector reaches π / num_arms to both sides;
    the clockwise edge belongs to it. Source: the tutorial notebook's direction bins, with the angle wrapped.
    """
    direction = seen["xy_direction_to_target"]
    angle = jnp.arctan2(direction[1], direction[0]) - seen["disk_rotation"][2]
    sectors = jnp.floor(angle * num_arms / (2 * jnp.pi) + 0.5)
    return jnp.mod(sectors, num_arms).astype(jnp.int32)


def steps_to_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: how many arms each lies clockwise of the one that faces the target."""
    return jnp.mod(sector_of_target(seen, num_arms) - jnp.arange(num_arms), num_arms).astype(jnp.int32)


def num_sides(num_arms: int) -> int:
    """How many sides of the target an arm may be on: in a star of an even number, one may be opposite."""
    return 3 + (num_arms % 2 == 0)


def sides_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: where each arm is, looking towards the target: 0 closest to it, 1 on the left, 2 on
    the right, 3 opposite. Source: the tutorial notebook's exercise, whose stars have five arms."""
    steps = steps_to_target(seen, num_arms)
    # An arm from which the target lies a few arms on, counter-clockwise, is on the right of it.
    side = jnp.where(2 * steps < num_arms, 2, jnp.where(2 * steps > num_arms, 1, 3))
    return jnp.where(steps == 0, 0, side).astype(jnp.int32)
