"""Joints and tendons that follow others: MuJoCo's equalities `joint` and `tendon`.

Source: MuJoCo's documentation, Computation, "Constraint model", "Equality"; XML reference, "equality/joint".
Measured in MuJoCo 3.17: the wanted acceleration has no term of the polynomial's second derivative.
"""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.constraints.laws import RowGroup, TwoSided
from mujoco_compiled.constraints.solref import (
    SpringDamper,
    full_stiffness,
    impedance_at,
    read_spring,
    reference_at,
)
from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import Number, Vector, polynomial, total
from mujoco_compiled.smooth.paths import Linear, Path, Stretch, weighted
from mujoco_compiled.smooth.tendons import path_of, read_tendons


@dataclass(frozen=True)
class Coordinate:
    """A joint's position or a tendon's length in rad or m, less the one at rest."""

    path: Path
    rest: float


@dataclass(frozen=True)
class Coupling:
    """follower = polynomial(leader); without a leader, the polynomial's constant.

    polynomial: [5], by power. inverse_weight: MuJoCo's `dof_invweight0` or `tendon_invweight0` of both.
    """

    follower: Coordinate
    leader: Coordinate | None
    polynomial: Vector
    spring: SpringDamper
    inverse_weight: Number

    @property
    def dofs(self) -> list[int]:
        return [*self.follower.path.dofs, *(self.leader.path.dofs if self.leader else ())]


def read_couplings(fields: Fields) -> tuple[Coupling, ...]:
    """Those that are active from the start."""
    model, kinds = fields.model, (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON)
    found = np.flatnonzero(model.eq_active0 & np.isin(model.eq_type, kinds))
    return tuple(_coupling(fields, int(i)) for i in found)


def coupling_row(coupling: Coupling, stretched: Callable[[Path], Stretch], qvel: Vector) -> RowGroup:
    """How far the follower is ahead of where it should be. stretched: of a path in this state."""
    follower = stretched(coupling.follower.path)
    direction, lead = dict(follower.moment), 0.0
    if coupling.leader:
        leader = stretched(coupling.leader.path)
        lead = leader.length - coupling.leader.rest
        slope = polynomial([power * x for power, x in enumerate(coupling.polynomial)][1:], lead)
        for dof, coefficient in leader.moment.items():
            direction[dof] = direction.get(dof, 0.0) - slope * coefficient
    distance = follower.length - coupling.follower.rest - polynomial(coupling.polynomial, lead)
    impedance = impedance_at(coupling.spring.impedance, distance)
    reference = reference_at(coupling.spring, impedance, distance, weighted(direction, qvel))
    law = TwoSided(full_stiffness(impedance, coupling.inverse_weight))
    return RowGroup([direction], [reference], law)


def _coupling(fields: Fields, number: int) -> Coupling:
    model = fields.model
    is_of_joints = model.eq_type[number] == mujoco.mjtEq.mjEQ_JOINT
    ends = [int(end) for end in (model.eq_obj1id[number], model.eq_obj2id[number]) if end >= 0]
    weights = [
        fields.number("dof_invweight0", int(model.jnt_dofadr[end]))
        if is_of_joints
        else fields.number("tendon_invweight0", end)
        for end in ends
    ]
    follower, *leader = (_of_joint(model, end) if is_of_joints else _of_tendon(fields, end) for end in ends)
    solref = [float(x) for x in model.eq_solref[number]]
    return Coupling(
        follower=follower,
        leader=leader[0] if leader else None,
        polynomial=[float(x) for x in model.eq_data[number, :5]],
        spring=read_spring(solref, model.eq_solimp[number], model.opt.timestep),
        inverse_weight=total(weights),
    )


def _of_joint(model: mujoco.MjModel, joint: int) -> Coordinate:
    position, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    return Coordinate(Linear({position: 1.0}, {dof: 1.0}), float(model.qpos0[position]))


def _of_tendon(fields: Fields, number: int) -> Coordinate:
    tendon = read_tendons(fields.model, fields.own)[number]
    return Coordinate(path_of(tendon, number), float(fields.model.tendon_length0[number]))
