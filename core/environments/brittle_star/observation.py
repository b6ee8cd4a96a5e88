"""What biorobot's brittle stars observe, from the fields of a state that every engine gives."""

import jax
import jax.numpy as jnp

from core.environments.brittle_star.observables import BodyObservable
from core.physics.engine import PhysicsState

# Coordinates of the disk in qpos and qvel; the joints' follow, arm by arm and outwards.
NUM_ROOT_POSITIONS, NUM_ROOT_VELOCITIES = 7, 6


def observe_body(physics: PhysicsState, name: BodyObservable) -> jax.Array:
    """The observable [n]; joints come in pairs, in the disk's plane and out of it.

    The disk's velocities are along the world's axes. Every joint has one motor and no gear, so the motor's
    force is the joint's. Contacts are normal forces summed over a segment, in N; they and the motors' forces
    are those of the last physics step.
    """
    match name:
        case "joint_position":
            return physics.qpos[NUM_ROOT_POSITIONS:]
        case "joint_velocity":
            return physics.qvel[NUM_ROOT_VELOCITIES:]
        case "joint_actuator_force" | "actuator_force":
            return physics.derived["qfrc_actuator"][NUM_ROOT_VELOCITIES:]
        case "disk_position":
            return physics.qpos[:3]
        case "disk_rotation":
            return roll_pitch_yaw(physics.qpos[3:7])
        case "disk_linear_velocity":
            return physics.qvel[:3]
        case "disk_angular_velocity":
            return rotated(physics.qpos[3:7], physics.qvel[3:6])
        case "segment_contact":
            return physics.derived["sensordata"]


def roll_pitch_yaw(quaternion: jax.Array) -> jax.Array:
    """Angles [3] in rad about the fixed axes x, then y, then z, of a unit quaternion w x y z [4]."""
    w, x, y, z = quaternion
    roll = jnp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = jnp.arcsin(jnp.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jnp.stack([roll, pitch, yaw])


def rotated(quaternion: jax.Array, vector: jax.Array) -> jax.Array:
    """The vector [3] of the body's frame in the world's, by a unit quaternion w x y z [4]."""
    w, axis = quaternion[0], quaternion[1:]
    twice = 2 * jnp.cross(axis, vector)
    return vector + w * twice + jnp.cross(axis, twice)


def about_the_vertical(angle: jax.Array) -> jax.Array:
    """The quaternion w x y z [4] of a rotation by `angle` [] in rad."""
    zero = jnp.zeros(())
    return jnp.stack([jnp.cos(angle / 2), zero, zero, jnp.sin(angle / 2)])
