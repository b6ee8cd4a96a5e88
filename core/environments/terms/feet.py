"""Where a robot's feet are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from core.environments.terms.describe import moving_geoms, near_world, touchable
from core.patterns import matching_in_turn

# m: points of a sole are at most so much above its lowest one.
_FLAT = 0.005


@dataclass(frozen=True)
class Foot:
    """body: its number. point: [3] in the body's frame, m: the middle of the sole; of a round foot, the
    centre of its sphere. radius: m, of a round foot, otherwise 0: the sole is so much below the point.
    ground: the height of the world below it, in m. geoms: the numbers of those that can touch something."""

    body: int
    point: np.ndarray
    radius: float
    ground: float
    geoms: tuple[int, ...]


def feet_of(model: mujoco.MjModel, patterns: Sequence[str], qpos: np.ndarray) -> list[Foot]:
    """The feet, pattern by pattern. qpos: [nq], a pose in which they would rest on the world.

    Feet that can touch nothing of the world are at their bodies' origins, and on the ground in the pose.
    """
    if not patterns:
        return []
    data, contacts = near_world(model, qpos)
    moving, _ = touchable(model)
    bodies = matching_in_turn(patterns, [model.body(number).name for number in range(1, model.nbody)])
    return [_foot(model, data, contacts, int(model.body(name).id), moving) for name in bodies]


def _foot(
    model: mujoco.MjModel, data: mujoco.MjData, contacts: Sequence[Any], body: int, moving: Sequence[int]
) -> Foot:
    welded = model.body_weldid
    geoms = tuple(
        geom
        for geom in moving
        if welded[model.geom_bodyid[geom]] == welded[body]
        and _is_below(model, int(model.geom_bodyid[geom]), body)
    )
    origin, axes = data.xpos[body], data.xmat[body].reshape(3, 3)
    own = [contact for contact in contacts if set(map(int, contact.geom)) & set(geoms)]
    lowest = min((contact.dist for contact in own), default=0.0)
    radius, sole = 0.0, origin
    if len(geoms) == 1 and model.geom_type[geoms[0]] == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        radius, sole = float(model.geom_size[geoms[0], 0]), data.geom_xpos[geoms[0]]
    elif own:
        touching = [_point_of(contact, model) for contact in own if contact.dist <= lowest + _FLAT]
        sole = np.mean(touching, axis=0)
    ground = float(sole[2]) - radius - lowest
    return Foot(body, axes.T @ (sole - origin), radius, ground, geoms)


def _point_of(contact: Any, model: mujoco.MjModel) -> np.ndarray:
    """The point of a contact on its moving geom, [3]: half the distance from the middle, along the normal,
    which goes from the first geom to the second."""
    is_second = moving_geoms(model)[contact.geom[1]]
    return contact.pos + (0.5 if is_second else -0.5) * contact.dist * contact.frame[:3]


def _is_below(model: mujoco.MjModel, body: int, ancestor: int) -> bool:
    while body > ancestor:
        body = int(model.body_parentid[body])
    return body == ancestor
