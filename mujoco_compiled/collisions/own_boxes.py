"""Boxes that never move, whose places and sizes differ between environments: arenas of many layouts.

The program is written before the layouts are known: boxes differ only along the axes along which the model's
own boxes differ, and are turned otherwise only where the model turns them.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.fields import GEOMETRY, Fields
from mujoco_compiled.program.arithmetic import Vector

# Of a quaternion's imaginary part: less is rounding.
_SMALLEST_TURN = 1e-9


@dataclass(frozen=True)
class OwnBoxes:
    """pos, size: whether boxes differ along each axis, [3]. turned: the numbers of those that are turned."""

    pos: tuple[bool, ...]
    size: tuple[bool, ...]
    turned: frozenset[int] = frozenset()


def own_boxes(fields: Fields) -> OwnBoxes | None:
    """None where all environments have the model's own."""
    if not set(GEOMETRY).intersection(fields.own):
        return None
    model = fields.model
    fixed = fixed_boxes(model)
    pos, size = (
        tuple(bool(x) for x in np.ptp(values[fixed], axis=0) > 0)
        for values in (model.geom_pos, model.geom_size)
    )
    turned = frozenset(box for box in fixed.tolist() if _is_turned(model, box))
    every = (True,) * 3
    if len(fixed) == 1:
        return OwnBoxes(every, every, turned)
    return OwnBoxes(pos, size, turned)


def _is_turned(model: mujoco.MjModel, box: int) -> bool:
    """Whether the box is turned within its body."""
    return bool(np.abs(model.geom_quat[box, 1:]).max() > _SMALLEST_TURN)


def own_numbers(fields: Fields, name: str, number: int, differs: tuple[bool, ...]) -> Vector:
    """A box's place or size, [3] in m: an environment's own numbers along the axes that differ."""
    nominal, own = Fields(fields.model).row(name, number), fields.row(name, number)
    return [one if is_own else other for is_own, one, other in zip(differs, own, nominal, strict=True)]


def fixed_boxes(model: mujoco.MjModel) -> np.ndarray:
    """Their numbers, in order."""
    is_fixed = model.body_treeid[model.geom_bodyid] < 0
    return np.flatnonzero(is_fixed & (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX))
