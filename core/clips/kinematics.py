"""Where the poses of a clip put a body, by MuJoCo's own forward kinematics."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.clips.clip import Clip
from core.clips.quaternions import Array
from core.clips.skeleton import Skeleton


def qpos(clip: Clip, skeleton: Skeleton) -> Array:
    """MuJoCo's positions of each frame, [T, nq]; what else the model has is at its reference. For an aligned
    clip."""
    rows = np.tile(np.asarray(skeleton.model.qpos0), (clip.num_frames, 1))
    if skeleton.root_joint is not None:
        start = skeleton.root_address
        rows[:, start : start + 3] = clip.root_position
        rows[:, start + 3 : start + 7] = clip.root_orientation
    rows[:, skeleton.joint_addresses] = clip.joint_positions
    return rows


@dataclass(frozen=True, eq=False)
class Poses:
    """Where bodies and geoms are in each of T frames, in the world.

    body_positions: [T, nbody, 3] m. body_turns: [T, nbody, 3, 3], rotation matrices. geom_positions,
    geom_turns: as those, of geoms.
    """

    body_positions: Array
    body_turns: Array
    geom_positions: Array
    geom_turns: Array


def poses(rows: Array, model: mujoco.MjModel) -> Poses:
    """Forward kinematics of MuJoCo. rows: [T, nq]."""
    data = mujoco.MjData(model)
    found = Poses(
        np.empty((len(rows), model.nbody, 3)),
        np.empty((len(rows), model.nbody, 3, 3)),
        np.empty((len(rows), model.ngeom, 3)),
        np.empty((len(rows), model.ngeom, 3, 3)),
    )
    for frame, row in enumerate(rows):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        found.body_positions[frame] = data.xpos
        found.body_turns[frame] = data.xmat.reshape(-1, 3, 3)
        found.geom_positions[frame] = data.geom_xpos
        found.geom_turns[frame] = data.geom_xmat.reshape(-1, 3, 3)
    return found


def floor_height(model: mujoco.MjModel) -> float:
    """m, of the world's level plane; 0 if it has none."""
    planes = (np.asarray(model.geom_type) == int(mujoco.mjtGeom.mjGEOM_PLANE)) & (
        np.asarray(model.geom_bodyid) == 0
    )
    return max((float(model.geom_pos[geom][2]) for geom in np.flatnonzero(planes)), default=0.0)


def colliding_geoms(skeleton: Skeleton) -> NDArray[np.int_]:
    """Those of the body that collide; all of it if none does."""
    model = skeleton.model
    of_body = np.isin(np.asarray(model.geom_bodyid), skeleton.bodies[skeleton.bodies > 0])
    collide = of_body & ((np.asarray(model.geom_contype) | np.asarray(model.geom_conaffinity)) > 0)
    return np.flatnonzero(collide if collide.any() else of_body)


def lowest(found: Poses, skeleton: Skeleton) -> Array:
    """m, the height of each of its geoms' lowest points, [T, number of geoms]. At least one column: a body
    without geoms has the height of its root."""
    geoms = colliding_geoms(skeleton)
    if not len(geoms):
        return found.body_positions[:, skeleton.root_body, 2:]
    return np.stack(list(_heights(found, skeleton.model, geoms)), axis=1)


def _heights(found: Poses, model: mujoco.MjModel, geoms: NDArray[np.int_]) -> Iterator[Array]:
    kinds = mujoco.mjtGeom
    for geom in geoms:
        centre = found.geom_positions[:, geom, 2]
        # The world's z axis in the geom's frame.
        up = found.geom_turns[:, geom, 2]
        size = np.asarray(model.geom_size[geom])
        kind = int(model.geom_type[geom])
        if kind == int(kinds.mjGEOM_MESH):
            mesh = int(model.geom_dataid[geom])
            first = int(model.mesh_vertadr[mesh])
            vertices = np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])])
            yield centre + (up @ vertices.T).min(axis=1)
        elif kind == int(kinds.mjGEOM_CAPSULE):
            yield centre - size[0] - np.abs(up[:, 2]) * size[1]
        elif kind == int(kinds.mjGEOM_CYLINDER):
            yield centre - np.abs(up[:, 2]) * size[1] - np.sqrt(np.maximum(1 - up[:, 2] ** 2, 0)) * size[0]
        elif kind == int(kinds.mjGEOM_BOX):
            yield centre - np.abs(up) @ size
        elif kind == int(kinds.mjGEOM_ELLIPSOID):
            yield centre - np.linalg.norm(up * size, axis=1)
        else:
            yield centre - size[0]
