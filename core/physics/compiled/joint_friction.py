"""Joints with friction of their own.

Source: MuJoCo's documentation, Computation, "Constraint model", "Friction loss".
"""

from dataclasses import dataclass

from core.physics.compiled.arithmetic import Matrix, Number, Vector, absolute, clip, select
from core.physics.compiled.fields import Fields, is_zero
from core.physics.compiled.laws import Slope
from core.physics.compiled.rows import Group
from core.physics.compiled.softness import impedance_at, read_softness


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

    def fall(self, before: Vector, after: Vector) -> Number:
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
class JointFriction:
    """Of a degree of freedom. damping: of the reference acceleration."""

    dof: int
    damping: Number
    law: Friction


def read_joint_frictions(fields: Fields) -> tuple[JointFriction, ...]:
    """The degrees of freedom with a frictionloss; all of them, where it is an environment's own."""
    model, found = fields.model, list[JointFriction]()
    for dof in range(model.nv):
        most = fields.number("dof_frictionloss", dof)
        if is_zero(most):
            continue
        softness = read_softness(fields.row("dof_solref", dof), model.dof_solimp[dof], model.opt.timestep)
        impedance = impedance_at(softness.impedance, 0.0)
        stiffness = impedance / ((1.0 - impedance) * fields.number("dof_invweight0", dof))
        found.append(JointFriction(dof, softness.damping, Friction(stiffness, most)))
    return tuple(found)


def friction_row(friction: JointFriction, qvel: Vector) -> Group:
    """Against the joint's speed."""
    return Group([{friction.dof: 1.0}], [-friction.damping * qvel[friction.dof]], friction.law)
