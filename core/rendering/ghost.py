"""The ghost: a translucent copy of a body, at the positions of the clip that it follows."""

import copy
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from core.rendering.scene import SHOWN_GROUPS

# The page draws the same, in api/pages/lib/replay/ghost.js.
COLOUR = (0.16, 0.62, 0.56, 0.3)


class Ghost:
    """model: as it is drawn. body: one of the kinematic tree that is copied."""

    def __init__(self, model: mujoco.MjModel, body: int) -> None:
        ghost = copy.copy(model)
        own = ghost.body_rootid[ghost.geom_bodyid] == ghost.body_rootid[body]
        is_drawn = own & (ghost.geom_group < SHOWN_GROUPS) & (ghost.geom_rgba[:, 3] > 0)
        # A skin's points belong to the scene, which has them where the body is: geoms stand in for it.
        ghost.geom_group[:] = np.where(is_drawn | (own & (ghost.nskin > 0)), 0, SHOWN_GROUPS)
        ghost.geom_matid[:] = -1
        ghost.geom_rgba[:] = COLOUR
        self._model, self._data = ghost, mujoco.MjData(ghost)
        self._options = mujoco.MjvOption()
        for flag in (mujoco.mjtVisFlag.mjVIS_SKIN, mujoco.mjtVisFlag.mjVIS_TENDON):
            self._options.flags[flag] = 0
        self._options.sitegroup[:] = 0

    def add(self, scene: Any, qpos: NDArray[np.float64]) -> None:
        """Add it to the scene at the positions qpos [nq]."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        mujoco.mjv_addGeoms(self._model, self._data, self._options, mujoco.MjvPerturb(), moving, scene)
