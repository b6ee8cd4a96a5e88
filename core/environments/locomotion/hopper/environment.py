"""A planar one-legged body that learns to hop. Source: Erez et al., 2011; rewards as in brax.envs.hopper."""

import jax
import jax.numpy as jnp

from core.environments.locomotion.hopper.info import HopperOptions
from core.environments.locomotion.planar import PlanarWalker, is_inside
from core.environments.simulation import Ends, numbers
from core.physics.engine import EngineBuilder, PhysicsState


def make(options: HopperOptions, build_engine: EngineBuilder) -> PlanarWalker:
    """The hopper under these options, moved by the engine that `build_engine` makes."""

    def other_joints_are_healthy(physics: PhysicsState) -> jax.Array:
        joints = jnp.concatenate([physics.qpos[2:], physics.qvel])
        return jnp.all(is_inside(joints, options.healthy_state_range))

    other_ends = [
        Ends(numbers("qpos", range(2, 6)), *options.healthy_state_range),
        Ends(numbers("qvel", range(6)), *options.healthy_state_range),
    ]
    return PlanarWalker("hopper", options, build_engine, other_joints_are_healthy, other_ends)
