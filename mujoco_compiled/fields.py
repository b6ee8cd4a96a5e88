"""A model's numbers, some of which differ between environments."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from core.physics.model import model_field
from mujoco_compiled.program.arithmetic import Number, Vector, maximum, select
from mujoco_compiled.program.program import Symbol

# Numbers of some of `engine.MODEL_FIELDS`, flattened, in place of the model's own.
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
