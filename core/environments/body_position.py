"""A body's position, computed from its joints: for metrics that an environment does not report itself."""

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.physics.engine import PhysicsState

_Position = Callable[[PhysicsState], jax.Array]


def body_position(model: mujoco.MjModel, body: int) -> Callable[[PhysicsState], Mapping[str, jax.Array]]:
    """A function that reads the body's `height` and `distance_from_origin`, [] each, in metres.

    The distance is in three dimensions, as in Brax. The result is empty for a body that does not travel by
    joints of its own, and has no height for one that stays level.
    """
    position, rises = _position(model, body)
    if position is None:
        return lambda physics: {}

    def read(physics: PhysicsState) -> Mapping[str, jax.Array]:
        where = position(physics)
        found = {"distance_from_origin": jnp.linalg.norm(where)}
        return found | {"height": where[2]} if rises else found

    return read


def _position(model: mujoco.MjModel, body: int) -> tuple[_Position | None, bool]:
    """A function that reads a body's position [3], or None if its joints do not determine it; and whether
    the body can rise."""
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count == 0 or model.body_parentid[body] != 0:
        return None, False
    start = int(model.jnt_qposadr[first])
    if model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
        return lambda physics: physics.qpos[start : start + 3], True
    # Slides move it along fixed axes, up to a hinge, which turns the axes after it.
    kinds = model.jnt_type[first : first + count]
    slides = kinds == mujoco.mjtJoint.mjJNT_SLIDE
    num_slides = int(np.argmin([*slides, False]))
    turned_about_itself = not model.jnt_pos[first + num_slides : first + count].any()
    if num_slides == 0 or slides[num_slides:].any() or not turned_about_itself:
        return None, False
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_quat[body])
    axes = (model.jnt_axis[first : first + num_slides] @ rotation.reshape(3, 3).T).astype(np.float32)
    end = start + num_slides
    origin = (model.body_pos[body] - model.qpos0[start:end] @ axes).astype(np.float32)
    return lambda physics: origin + physics.qpos[start:end] @ axes, bool(axes[:, 2].any())
