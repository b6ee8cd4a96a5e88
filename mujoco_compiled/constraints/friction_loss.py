"""Joints and tendons with friction of their own.

Source: MuJoCo's documentation, Computation, "Constraint model", "Friction loss".
"""

from dataclasses import dataclass

from mujoco_compiled.constraints.laws import RowGroup, Slope
from mujoco_compiled.constraints.solref import (
    SpringDamper,
    full_stiffness,
    impedance_at,
    read_spring,
)
from mujoco_compiled.fields import Fields, is_zero
from mujoco_compiled.program.arithmetic import Matrix, Number, Vector, absolute, clip, select
from mujoco_compiled.smooth.paths import Linear, Path, Stretch
from mujoco_compiled.smooth.tendons import path_of, read_tendons


@dataclass(frozen=True)
class Friction:
    """A `laws.Law` of one row: its force is at most `most`, MuJoCo's frictionloss in N or N m.

    The cost is quadratic up to there, and beyond goes on as straight lines.
    """

    stiffness: Number
    most: Number

    def forces(self, residual: Vector) -> Vector:
        return [-self.stiffness * self._kept(residual[0])]

    def weights(self, residual: Vector) -> Matrix:
        return [[select(absolute(residual[0]) < self._bound, self.stiffness, 0.0)]]

    def slope(self, residual: Vector, rates: Vector) -> Slope:
        (x,), (rate,) = residual, rates
        squared = self.stiffness * (rate * rate)

        def slope(step: Number) -> tuple[Number, Number]:
            there = x + step * rate
            first = (self.stiffness * rate) * self._kept(there)
            return first, select(absolute(there) < self._bound, squared, 0.0)

        return slope

    def cost(self, residual: Vector) -> Number:
        kept = self._kept(residual[0])
        return self.stiffness * (kept * (residual[0] - 0.5 * kept))

    def cost_decrease(self, before: Vector, after: Vector) -> Number:
        (x,), (y,) = before, after
        kept, then = self._kept(x), self._kept(y)
        beyond = (x - kept) + (y - then)
        return (0.5 * self.stiffness) * ((kept + then) * (x - y) + (kept - then) * beyond)

    @property
    def _bound(self) -> Number:
        return self.most / self.stiffness

    def _kept(self, x: Number) -> Number:
        return clip(x, -self._bound, self._bound)


@dataclass(frozen=True)
class FrictionLoss:
    """The friction of a degree of freedom or a tendon. damping: of the reference acceleration."""

    path: Path
    damping: Number
    law: Friction


def read_friction_losses(fields: Fields) -> tuple[FrictionLoss, ...]:
    """The friction of tendons and of degrees of freedom: of all these, where environments have their own."""
    model, found = fields.model, list[FrictionLoss]()
    for dof in range(model.nv):
        most = fields.number("dof_frictionloss", dof)
        if not is_zero(most):
            weight = fields.number("dof_invweight0", dof)
            spring = read_spring(fields.row("dof_solref", dof), model.dof_solimp[dof], model.opt.timestep)
            found.append(_friction_loss(Linear({}, {dof: 1.0}), most, weight, spring))
    for number, tendon in enumerate(read_tendons(model, fields.own)):
        most = fields.number("tendon_frictionloss", number)
        if not is_zero(most):
            weight, solimp = fields.number("tendon_invweight0", number), model.tendon_solimp_fri[number]
            spring = read_spring(fields.row("tendon_solref_fri", number), solimp, model.opt.timestep)
            found.append(_friction_loss(path_of(tendon, number), most, weight, spring))
    return tuple(found)


def friction_row(friction: FrictionLoss, stretched: Stretch, qvel: Vector) -> RowGroup:
    """Against the speed. stretched: of the friction's path."""
    return RowGroup([stretched.moment], [-friction.damping * stretched.rate(qvel)], friction.law)


def _friction_loss(path: Path, most: Number, inverse_weight: Number, spring: SpringDamper) -> FrictionLoss:
    impedance = impedance_at(spring.impedance, 0.0)
    law = Friction(full_stiffness(impedance, inverse_weight), most)
    return FrictionLoss(path, spring.damping, law)
