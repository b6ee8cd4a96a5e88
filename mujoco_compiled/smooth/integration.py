"""A timestep of velocities and positions.

Source: MuJoCo's documentation, Computation, "Numerical integration".
"""

from collections.abc import Sequence
from typing import Literal

from mujoco_compiled.fields import is_zero
from mujoco_compiled.program.arithmetic import (
    Vector,
    cosine,
    dot,
    maximum,
    normalized,
    quaternion_product,
    scale,
    sine,
    sqrt,
)
from mujoco_compiled.smooth.dynamics import Entries
from mujoco_compiled.smooth.forces import damper_force
from mujoco_compiled.smooth.paths import Slope
from mujoco_compiled.smooth.tendons import add_outer
from mujoco_compiled.smooth.tree import Tree

# Which forces are taken at the velocities after the timestep: none, the joints' dampers, or all that are
# linear in the velocity (MuJoCo's `implicitfast`).
Implicit = Literal["nothing", "damping", "velocities"]


def implicit_inertia(tree: Tree, qvel: Vector, timestep: float) -> Entries:
    """What is added to M, in its own entries: h times the joints' damping, or how the force of one that is
    not linear changes at this velocity."""
    found: Entries = dict.fromkeys(tree.entries, 0.0)
    for i, dof in enumerate(tree.dofs):
        _, slope = damper_force(dof.damping, qvel[i])
        found[i, i] = -timestep * slope
    return found


def add_slopes(inertia: Entries, slopes: Sequence[Slope], timestep: float) -> None:
    """Subtract h times the forces' slopes, in M's own entries."""
    for stretched, slope in slopes:
        if not is_zero(slope):
            add_outer(inertia, stretched.moment, -timestep * slope)


def integrated(tree: Tree, qpos: Vector, qvel: Vector, timestep: float) -> Vector:
    """The positions after a timestep at these speeds."""
    moved = list(qpos)
    for body in tree.bodies:
        for joint in body.joints:
            place, dof = joint.qpos, joint.dof
            if joint.kind in ("slide", "hinge"):
                moved[place] = qpos[place] + timestep * qvel[dof]
                continue
            if joint.kind == "free":
                for axis in range(3):
                    moved[place + axis] = qpos[place + axis] + timestep * qvel[dof + axis]
                place, dof = place + 3, dof + 3
            moved[place : place + 4] = _turned(qpos[place : place + 4], qvel[dof : dof + 3], timestep)
    return moved


def _turned(quaternion: Vector, speed: Vector, timestep: float) -> Vector:
    """The quaternion after a timestep at this angular velocity [3] in the body's frame, in rad/s."""
    rate = sqrt(maximum(dot(speed, speed), 1e-30))
    half = (0.5 * timestep) * rate
    turn = [cosine(half), *scale(speed, sine(half) / rate)]
    return normalized(quaternion_product(normalized(quaternion), turn))
