"""A body's position, computed from its joints: the numbers that every engine has without deriving them."""

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.physics.engine import PhysicsState


@dataclass(frozen=True)
class Slides:
    """A body that slides along fixed axes: where it is, origin [3] + Σ qpos[start + k] axes[k], in m.

    axes: [number of slides, 3].
    """

    start: int
    origin: np.ndarray
    axes: np.ndarray

    def position(self, qpos: Any) -> Any:
        """[3], of an array of JAX or of NumPy."""
        return _stacked(self._coordinates(qpos), qpos)

    def velocity(self, before: Any, after: Any, dt: float) -> Any:
        """(p' − p) / dt [3] in m/s, of qpos before and after; number by number, which compiles to less."""
        pairs = zip(self._coordinates(before), self._coordinates(after), strict=True)
        return _stacked([(new - old) / dt for old, new in pairs], after)

    def _coordinates(self, qpos: Any) -> list[Any]:
        """x, y and z, without additions of 0 and products with 0."""
        found = list[Any]()
        for origin, parts in zip(self.origin, self.axes.T, strict=True):
            moved = [part * qpos[self.start + k] for k, part in enumerate(parts) if part]
            if origin or not moved:
                moved.append(origin)
            found.append(reduce(operator.add, moved))
        return found

    @property
    def rises(self) -> bool:
        return bool(self.axes[:, 2].any())

    @property
    def upright(self) -> int | None:
        """Which slide is the height above the origin; None if it takes more than one to know."""
        along = np.flatnonzero(self.axes[:, 2])
        return int(along[0]) if len(along) == 1 and self.axes[along[0], 2] == 1.0 else None


def _stacked(numbers: Sequence[Any], like: Any) -> Any:
    """[n], by the library of an array."""
    return (np if isinstance(like, np.ndarray) else jnp).stack(numbers)


def free_joint_of(model: mujoco.MjModel, body: int) -> int | None:
    """The first index of the body's free joint in qpos; None if it has none."""
    first = int(model.body_jntadr[body])
    if first < 0 or model.jnt_type[first] != mujoco.mjtJoint.mjJNT_FREE:
        return None
    return int(model.jnt_qposadr[first])


def slides_of(model: mujoco.MjModel, body: int) -> Slides | None:
    """The slides that move a body of the world; None if others, or none, determine where it is."""
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count == 0 or model.body_parentid[body] != 0:
        return None
    # Slides move it along fixed axes, up to a hinge, which turns the axes after it.
    slides = model.jnt_type[first : first + count] == mujoco.mjtJoint.mjJNT_SLIDE
    num_slides = int(np.argmin([*slides, False]))
    turned_about_itself = not model.jnt_pos[first + num_slides : first + count].any()
    if num_slides == 0 or slides[num_slides:].any() or not turned_about_itself:
        return None
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_quat[body])
    axes = (model.jnt_axis[first : first + num_slides] @ rotation.reshape(3, 3).T).astype(np.float32)
    start = int(model.jnt_qposadr[first])
    origin = (model.body_pos[body] - model.qpos0[start : start + num_slides] @ axes).astype(np.float32)
    return Slides(start, origin, axes)


def body_position(model: mujoco.MjModel, body: int) -> Callable[[PhysicsState], Mapping[str, jax.Array]]:
    """A function that reads the body's `height` and `distance_from_origin`, [] each, in metres.

    The distance is in three dimensions, as in Brax. The result is empty for a body that does not travel by
    joints of its own, and has no height for one that stays level.
    """
    first, slides = free_joint_of(model, body), slides_of(model, body)
    if first is None and slides is None:
        return lambda physics: {}
    free = slice(first, (first or 0) + 3)

    def read(physics: PhysicsState) -> Mapping[str, jax.Array]:
        where = slides.position(physics.qpos) if slides else physics.qpos[free]
        found = {"distance_from_origin": jnp.linalg.norm(where)}
        return found | {"height": where[2]} if slides is None or slides.rises else found

    return read
