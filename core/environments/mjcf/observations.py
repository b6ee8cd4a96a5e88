"""Which numbers of a state an observation term reads, and in which order."""

from typing import Literal

import mujoco
import numpy as np

from core.environments.mjcf.contacts import is_ours
from core.environments.mjcf.step_context import ModelIndex


def visible_positions(
    parts: ModelIndex, root_position: Literal["all", "height", "none"] | None
) -> np.ndarray:
    """Places in qpos that are observed: all, all but the root's x and y, or all but its x, y and z."""
    start = parts.free_joint(parts.root)
    if start is None or root_position == "all":
        hidden = []
    elif root_position == "none":
        hidden = [start, start + 1, start + 2]
    else:
        hidden = [start, start + 1]
    return np.setdiff1d(np.arange(parts.model.nq), hidden)


def sensor_places(parts: ModelIndex, names: list[str] | None) -> np.ndarray:
    """Places in sensordata: of the named sensors in their order, or of all of the model's own."""
    if names is not None:
        return parts.sensors(names)
    own = [sensor for sensor in range(parts.model.nsensor) if not is_ours(parts.model.sensor(sensor).name)]
    starts, sizes = parts.model.sensor_adr, parts.model.sensor_dim
    return np.concatenate([np.arange(starts[sensor], starts[sensor] + sizes[sensor]) for sensor in own])


def limited_joints(parts: ModelIndex, names: list[str] | None) -> np.ndarray:
    """Numbers of these joints; if None, of all hinges and slides that have a range."""
    if names is not None:
        return np.array([parts.model.joint(name).id for name in names])
    kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return np.flatnonzero(parts.model.jnt_limited.astype(bool) & np.isin(parts.model.jnt_type, kinds))
