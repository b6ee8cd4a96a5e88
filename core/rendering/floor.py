"""Floors as they are drawn: below a body in the air a checkered one, and one that holds it without an end."""

from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DARK, LIGHT = (0.36, 0.43, 0.52), (0.62, 0.69, 0.77)
_TILES, _FAR = 20, 100.0
_EVERYWHERE = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)


def floor_below(model: mujoco.MjModel, root: int, centre: Floats, radius: float) -> float | None:
    """The height in metres of a floor out of the body's reach, without which its motion is hard to see.

    None if there is a floor, or if the body may fall, because its floor would have to hold it.
    """
    if np.isin(model.geom_type, _EVERYWHERE).any() or _may_fall(model, root):
        return None
    return float(centre[2]) - 1.05 * radius


def lay(scene: Any, height: float, around: Floats, radius: float) -> None:
    """Add a floor to the scene, up to the horizon, with tiles near the point `around`."""
    side = 0.6 * radius
    # Moves by whole pairs of tiles, so that the pattern stays in place.
    x, y = (2 * side * np.floor(around[:2] / (2 * side))).tolist()
    between = tuple((dark + light) / 2 for dark, light in zip(DARK, LIGHT, strict=True))
    _plane(scene, (x, y, height), _FAR * radius, between)
    for row, column in product(range(-_TILES // 2, _TILES // 2), repeat=2):
        at = (x + (column + 0.5) * side, y + (row + 0.5) * side, height + 0.002 * radius)
        _plane(scene, at, side / 2, LIGHT if (row + column) % 2 else DARK)


def without_end(model: mujoco.MjModel) -> None:
    """Draw level planes up to the horizon: their contacts have no end, and a fast body passes the drawn one.

    A plane whose texture is a picture of it keeps its size.
    """
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        material, size = int(model.geom_matid[geom]), model.geom_size[geom, :2].copy()
        is_level = model.geom_bodyid[geom] == 0 and np.allclose(model.geom_quat[geom, 1:3], 0.0)
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if not (is_level and touches and (size > 0).all() and _may_repeat(model, material)):
            continue
        model.geom_size[geom, :2] = 0.0
        if material >= 0 and not model.mat_texuniform[material]:
            # Repeats are counted over the whole plane where it ends, over two metres where it does not.
            model.mat_texrepeat[material] /= size


def _may_repeat(model: mujoco.MjModel, material: int) -> bool:
    """Whether the material's texture may go on beyond the plane, and is no other geom's."""
    if material < 0:
        return True
    is_pattern = model.mat_texuniform[material] or (model.mat_texrepeat[material] > 1).all()
    return bool(is_pattern) and int((model.geom_matid == material).sum()) == 1


def _may_fall(model: mujoco.MjModel, root: int) -> bool:
    """Whether a joint of the kinematic tree lets the body fall or climb."""
    joints = np.flatnonzero(model.body_rootid[model.jnt_bodyid] == root)
    kinds, axes = model.jnt_type[joints], model.jnt_axis[joints]
    lifted = (kinds == mujoco.mjtJoint.mjJNT_SLIDE) & (np.abs(axes[:, 2]) > 0.01)
    return bool(lifted.any() or (kinds == mujoco.mjtJoint.mjJNT_FREE).any())


def _plane(scene: Any, at: tuple[float, ...], half: float, colour: tuple[float, ...]) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    mujoco.mjv_initGeom(
        scene.geoms[scene.ngeom],
        mujoco.mjtGeom.mjGEOM_PLANE,
        np.array([half, half, 0.1]),
        np.array(at),
        np.eye(3).ravel(),
        np.array([*colour, 1.0], np.float32),
    )
    scene.geoms[scene.ngeom].specular = 0.1
    scene.ngeom += 1
