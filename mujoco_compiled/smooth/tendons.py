"""Fixed tendons: their length is a sum of joints' positions, each times a coefficient.

Source: MuJoCo's documentation, Modeling, "Tendon", and Computation, "Passive forces".
"""

from dataclasses import dataclass

import mujoco

from mujoco_compiled.fields import NOMINAL, Fields, Own
from mujoco_compiled.program.arithmetic import Number, Vector, clip, total
from mujoco_compiled.smooth.dynamics import Entries
from mujoco_compiled.smooth.tree import Range

# By the address of a position or of a velocity.
Coefficients = dict[int, Number]


@dataclass(frozen=True)
class Tendon:
    """of_positions: by address in qpos; moment: the same coefficients by degree of freedom.

    stiffness, damping, armature: of the length. rest: lengths between which the spring does not pull.
    """

    of_positions: Coefficients
    moment: Coefficients
    stiffness: float
    damping: float
    armature: float
    rest: Range


def read_tendons(model: mujoco.MjModel, own: Own = NOMINAL) -> tuple[Tendon, ...]:
    """The model's tendons, which must be fixed ones. own: see `Fields`."""
    return tuple(_tendon(Fields(model, own), number) for number in range(model.ntendon))


def weighted(coefficients: Coefficients, values: Vector) -> Number:
    """The values at the coefficients' addresses, each times its coefficient: a length or its rate."""
    return total(coefficient * values[place] for place, coefficient in coefficients.items())


def tendon_forces(tendons: tuple[Tendon, ...], qpos: Vector, qvel: Vector) -> Vector:
    """[nv]: the tendons' springs and dampers."""
    found: Vector = [0.0] * len(qvel)
    for tendon in tendons:
        force: Number = 0.0
        if tendon.stiffness:
            length = weighted(tendon.of_positions, qpos)
            force = force - tendon.stiffness * (length - clip(length, *tendon.rest))
        if tendon.damping:
            force = force - tendon.damping * weighted(tendon.moment, qvel)
        for dof, coefficient in tendon.moment.items():
            found[dof] = found[dof] + coefficient * force
    return found


def with_armature(tendons: tuple[Tendon, ...], mass: Entries) -> Entries:
    """M with the tendons' armature, in M's own entries only, as MuJoCo has it."""
    found = dict(mass)
    for tendon in tendons:
        if tendon.armature:
            add_outer(found, tendon.moment, tendon.armature)
    return found


def add_outer(entries: Entries, moment: Coefficients, factor: Number) -> None:
    """Add factor · m mᵀ to those of the entries that exist."""
    for i, one in moment.items():
        for j, other in moment.items():
            if (i, j) in entries:
                entries[i, j] = entries[i, j] + (one * other) * factor


def _tendon(fields: Fields, number: int) -> Tendon:
    model, bit = fields.model, mujoco.mjtDisableBit
    of_positions, moment = Coefficients(), Coefficients()
    first = int(model.tendon_adr[number])
    for place in range(first, first + int(model.tendon_num[number])):
        joint, coefficient = int(model.wrap_objid[place]), float(model.wrap_prm[place])
        for address, into in ((model.jnt_qposadr, of_positions), (model.jnt_dofadr, moment)):
            into[int(address[joint])] = into.get(int(address[joint]), 0.0) + coefficient
    low, high = (float(x) for x in model.tendon_lengthspring[number])
    return Tendon(
        of_positions=of_positions,
        moment=moment,
        stiffness=0.0 if fields.disables(bit.mjDSBL_SPRING) else float(model.tendon_stiffness[number]),
        damping=0.0 if fields.disables(bit.mjDSBL_DAMPER) else float(model.tendon_damping[number]),
        armature=float(model.tendon_armature[number]),
        rest=(low, high),
    )
