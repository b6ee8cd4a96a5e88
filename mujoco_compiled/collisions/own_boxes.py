"""Boxes that never move, whose places and sizes differ between environments: arenas of many layouts.

The program is written before the layouts are known. What must hold in all of them the model says: the numeric
`box_spacing` has in place k - 1 the least free length, in m, between a box and the k-th after it in the order
of their numbers, in any layout; boxes that the model turns do not count. Boxes differ only along the axes
along which the model's own boxes differ, and are turned otherwise only where the model turns them.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.fields import GEOMETRY, Fields
from mujoco_compiled.program.arithmetic import Vector

_SPACING = "box_spacing"
# Of a quaternion's imaginary part: less is rounding.
_SMALLEST_TURN = 1e-9


@dataclass(frozen=True)
class OwnBoxes:
    """spacing: see the module. pos, size: whether boxes differ along each axis, [3]. turned: the numbers of
    those that are turned."""

    spacing: tuple[float, ...]
    pos: tuple[bool, ...]
    size: tuple[bool, ...]
    turned: frozenset[int] = frozenset()

    def most_in_reach(self, reach: float) -> int:
        """The least number k such that a geom is near one box at most of any box and the k-th, 2k-th, … after
        it. reach: see `Choice`."""
        far_enough = [space > 2.0 * reach for space in self.spacing]
        steps = range(1, len(far_enough) + 1)
        return next((k for k in steps if all(far_enough[k - 1 :: k])), len(far_enough) + 1)


def own_boxes(fields: Fields) -> OwnBoxes | None:
    """None where all environments have the model's own. Raises ValueError where the model does not say what
    must be known of them."""
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
        return OwnBoxes((), every, every, turned)
    return OwnBoxes(box_spacing(model), pos, size, turned)


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


def says_spacing(model: mujoco.MjModel) -> bool:
    """Whether the model says how far apart its boxes stay."""
    return any(model.numeric(index).name == _SPACING for index in range(model.nnumeric))


def box_spacing(model: mujoco.MjModel) -> tuple[float, ...]:
    """The box as the model has it."""
    if not says_spacing(model):
        raise ValueError(f"The model has no numeric {_SPACING}.")
    return tuple(float(x) for x in model.numeric(_SPACING).data)
