"""A model's numbers, some of which differ between environments."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from mujoco_compiled.program.arithmetic import Number, Vector, maximum, select
from mujoco_compiled.program.program import Symbol

# Fields of the model that may differ between environments, by their names in `mujoco.batch`. Constants that
# `mj_setConst` derives (`actuator_acc0`, `body_invweight0`, `body_subtreemass`, `dof_invweight0`,
# `tendon_invweight0`) are not recomputed: code that changes a mass must pass them, too. Those of `GEOMETRY`
# may differ for boxes that never move, and are passed together.
MODEL_FIELDS = (
    "actuator_acc0",
    "actuator_biasprm",
    "actuator_dynprm",
    "actuator_forcerange",
    "actuator_gainprm",
    "actuator_gear",
    "body_inertia",
    "body_invweight0",
    "body_ipos",
    "body_mass",
    "body_pos",
    "body_quat",
    "body_subtreemass",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "dof_invweight0",
    "geom_aabb",
    "geom_friction",
    "geom_pos",
    "geom_quat",
    "geom_rbound",
    "geom_size",
    "geom_solref",
    "jnt_stiffness",
    "opt.gravity",
    "tendon_invweight0",
)
# Where geoms are, how turned and how large, and the bounds that MuJoCo derives from it.
GEOMETRY = ("geom_aabb", "geom_pos", "geom_quat", "geom_rbound", "geom_size")


def model_field(model: Any, name: str) -> Any:
    """A field of a model, MuJoCo's or an engine's; fields of its options are called `opt.…`."""
    return getattr(model.opt, name.removeprefix("opt.")) if name.startswith("opt.") else getattr(model, name)


# Numbers of some of `MODEL_FIELDS`, flattened, in place of the model's own.
Own = Mapping[str, Vector]
NOMINAL: Own = {}


@dataclass(frozen=True)
class Fields:
    """The model's numbers, with an environment's own where it has some."""

    model: mujoco.MjModel
    own: Own = field(default_factory=dict[str, Vector])

    def row(self, name: str, number: int = 0) -> Vector:
        """The numbers of one of the field's elements, such as body_inertia's [3] of a body.

        A field of the options, such as `opt.gravity`, is one element.
        """
        values = np.asarray(model_field(self.model, name), np.float64)
        rows = values[None] if name.startswith("opt.") else values
        width = rows[0].size
        if name in self.own:
            return list(self.own[name][number * width : (number + 1) * width])
        return [float(x) for x in np.ravel(rows[number])]

    def number(self, name: str, number: int) -> Number:
        """The first number of one of the field's elements."""
        return self.row(name, number)[0]

    def disables(self, *bits: mujoco.mjtDisableBit) -> bool:
        """Whether the model disables one of these parts of MuJoCo."""
        return any(self.model.opt.disableflags & bit for bit in bits)


def divided(number: Number, mass: Number, otherwise: Number) -> Number:
    """number / mass, or another number where there is no mass."""
    if is_zero(mass):
        return otherwise
    if isinstance(mass, float):
        return number * (1.0 / mass)
    return select(mass < mujoco.mjMINVAL, otherwise, number / maximum(mass, mujoco.mjMINVAL))


def is_zero(number: Number) -> bool:
    """Whether the number is the constant 0; a number that only the running program knows never is."""
    return not isinstance(number, Symbol | np.ndarray) and number == 0.0
