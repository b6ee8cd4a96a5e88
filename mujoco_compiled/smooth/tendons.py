"""Tendons: their springs, dampers and armature.

The length of a fixed tendon is a sum of joints' positions, each times a coefficient; see `routes` for others.
Source: MuJoCo's documentation, Modeling, "Tendon", and Computation, "Passive forces".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco

from mujoco_compiled.fields import NOMINAL, Fields, Own
from mujoco_compiled.program.arithmetic import Number, Vector, clip, polynomial
from mujoco_compiled.smooth.dynamics import Entries
from mujoco_compiled.smooth.forces import damper_force
from mujoco_compiled.smooth.paths import (
    Coefficients,
    Linear,
    OfTendon,
    Path,
    Posture,
    Slope,
    Stretch,
    stretch,
)
from mujoco_compiled.smooth.routes import Route, read_route, route_drift, route_stretch
from mujoco_compiled.smooth.tree import Range, acts, law


@dataclass(frozen=True)
class Tendon:
    """stiffness, damping: polynomials of how far it is stretched and of its rate.
    armature: of the length. rest: lengths between which the spring does not pull."""

    path: Linear | Route
    stiffness: Vector
    damping: Vector
    armature: float
    rest: Range


def read_tendons(model: mujoco.MjModel, own: Own = NOMINAL) -> tuple[Tendon, ...]:
    """The model's tendons. own: see `Fields`."""
    return tuple(_tendon(Fields(model, own), number) for number in range(model.ntendon))


def path_of(tendon: Tendon, number: int, gear: Number = 1.0) -> Path:
    """What acts along the tendon with this number acts along, times `gear`."""
    if isinstance(tendon.path, Route):
        return OfTendon(number, gear, tuple(tendon.path.dofs))
    of_positions, moment = (
        {place: coefficient * gear for place, coefficient in coefficients.items()}
        for coefficients in (tendon.path.of_positions, tendon.path.moment)
    )
    return Linear(of_positions, moment)


def with_tendons(posture: Posture, tendons: Sequence[Tendon]) -> Posture:
    """The posture with the stretches of the tendons."""
    stretches = [
        route_stretch(tendon.path, posture)
        if isinstance(tendon.path, Route)
        else stretch(tendon.path, posture.qpos, ())
        for tendon in tendons
    ]
    return replace(posture, tendons=stretches)


def tendon_forces(tendons: Sequence[Tendon], stretches: Sequence[Stretch], qvel: Vector) -> Vector:
    """[nv]: the tendons' springs and dampers."""
    found: Vector = [0.0] * len(qvel)
    for tendon, stretched in zip(tendons, stretches, strict=True):
        force: Number = 0.0
        if acts(tendon.stiffness):
            beyond = stretched.length - clip(stretched.length, *tendon.rest)
            force = force - polynomial(tendon.stiffness, beyond) * beyond
        if acts(tendon.damping):
            force = force + damper_force(tendon.damping, stretched.rate(qvel))[0]
        for dof, coefficient in stretched.moment.items():
            found[dof] = found[dof] + coefficient * force
    return found


def tendon_slopes(tendons: Sequence[Tendon], stretches: Sequence[Stretch], qvel: Vector) -> list[Slope]:
    """Of the dampers' forces."""
    return [
        (stretched, damper_force(tendon.damping, stretched.rate(qvel))[1])
        for tendon, stretched in zip(tendons, stretches, strict=True)
        if acts(tendon.damping)
    ]


def with_armature(tendons: Sequence[Tendon], stretches: Sequence[Stretch], mass: Entries) -> Entries:
    """M with the tendons' armature, in M's own entries only, as MuJoCo has it."""
    found = dict(mass)
    for tendon, stretched in zip(tendons, stretches, strict=True):
        if tendon.armature:
            add_outer(found, stretched.moment, tendon.armature)
    return found


def armature_forces(tendons: Sequence[Tendon], posture: Posture, qvel: Vector) -> Coefficients:
    """By degree of freedom: the tendons' part of `qfrc_bias`, as the moment arms of spatial ones change."""
    found: Coefficients = {}
    for tendon, stretched in zip(tendons, posture.tendons, strict=True):
        if tendon.armature and isinstance(tendon.path, Route):
            force = tendon.armature * route_drift(tendon.path, posture, qvel)
            for dof, coefficient in stretched.moment.items():
                found[dof] = found.get(dof, 0.0) + coefficient * force
    return found


def add_outer(entries: Entries, moment: Coefficients, factor: Number) -> None:
    """Add factor · m mᵀ to those of the entries that exist."""
    for i, one in moment.items():
        for j, other in moment.items():
            if (i, j) in entries:
                entries[i, j] = entries[i, j] + (one * other) * factor


def _tendon(fields: Fields, number: int) -> Tendon:
    model, bit = fields.model, mujoco.mjtDisableBit
    is_fixed = model.wrap_type[model.tendon_adr[number]] == mujoco.mjtWrap.mjWRAP_JOINT
    low, high = (float(x) for x in model.tendon_lengthspring[number])
    return Tendon(
        path=_of_joints(model, number) if is_fixed else read_route(fields, number),
        stiffness=[] if fields.disables(bit.mjDSBL_SPRING) else law(fields, "tendon_stiffness", number),
        damping=[] if fields.disables(bit.mjDSBL_DAMPER) else law(fields, "tendon_damping", number),
        armature=float(model.tendon_armature[number]),
        rest=(low, high),
    )


def _of_joints(model: mujoco.MjModel, tendon: int) -> Linear:
    found = Linear({}, {})
    first = int(model.tendon_adr[tendon])
    for place in range(first, first + int(model.tendon_num[tendon])):
        joint, coefficient = int(model.wrap_objid[place]), float(model.wrap_prm[place])
        for address, into in ((model.jnt_qposadr, found.of_positions), (model.jnt_dofadr, found.moment)):
            into[int(address[joint])] = into.get(int(address[joint]), 0.0) + coefficient
    return found
