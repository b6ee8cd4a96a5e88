"""Geoms that never move, where each world has them: MuJoCo Warp places them once, where the model does."""

# A kernel is read by Warp's compiler, which types it in its own way.
# pyright: reportUntypedFunctionDecorator=false, reportAssignmentType=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false

from typing import Any

import mujoco
import numpy as np
import warp as wp


@wp.kernel
def _place(
    numbers: wp.array[int],
    origins: wp.array[wp.vec3],
    rotations: wp.array[wp.mat33],
    geom_pos: wp.array2d[wp.vec3],
    geom_xpos: wp.array2d[wp.vec3],
) -> None:
    world, index = wp.tid()
    geom = numbers[index]
    geom_xpos[world, geom] = origins[index] + rotations[index] @ geom_pos[world, geom]


class FixedGeoms:
    """Places of the geoms of bodies that never move."""

    def __init__(self, model: mujoco.MjModel, device: Any) -> None:
        at_rest = mujoco.MjData(model)
        mujoco.mj_kinematics(model, at_rest)
        numbers = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0)
        bodies = model.geom_bodyid[numbers]
        self._numbers = wp.array(numbers, dtype=int, device=device)
        self._origins = wp.array(at_rest.xpos[bodies], dtype=wp.vec3, device=device)
        self._rotations = wp.array(at_rest.xmat[bodies].reshape(-1, 3, 3), dtype=wp.mat33, device=device)

    def place(self, model: Any, data: Any) -> None:
        """Sets their `geom_xpos` from the worlds' own `geom_pos`."""
        wp.launch(
            _place,
            dim=(data.nworld, len(self._numbers)),
            inputs=[self._numbers, self._origins, self._rotations, model.geom_pos],
            outputs=[data.geom_xpos],
            device=data.qpos.device,
        )
