"""A model as the stages read it: bodies, joints and degrees of freedom in the order of the tree."""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from core.physics.compiled.arithmetic import Number, Vector

JointKind = Literal["free", "ball", "slide", "hinge"]
_KINDS: tuple[JointKind, ...] = ("free", "ball", "slide", "hinge")  # in MuJoCo's order


@dataclass(frozen=True)
class Joint:
    """qpos, dof: addresses of its first position and velocity. anchor, axis: in the body's frame, in m.

    reference, spring: positions (qpos0, qpos_spring) from its address on; stiffness: N/m or N m/rad.
    """

    kind: JointKind
    qpos: int
    dof: int
    anchor: Vector
    axis: Vector
    reference: Vector
    spring: Vector
    stiffness: Number


@dataclass(frozen=True)
class Body:
    """parent, root: numbers of bodies; 0 is the world, which has neither joints nor mass.

    position [3] in m and quaternion [4]: in the parent's frame. centre: of mass [3], in the body's frame.
    inertia: about the centre, along the body's axes: xx, yy, zz, xy, xz, yz in kg m². mass: kg.
    """

    parent: int
    root: int
    position: Vector
    quaternion: Vector
    centre: Vector
    inertia: Vector
    mass: Number
    joints: tuple[Joint, ...]


@dataclass(frozen=True)
class Dof:
    """ancestors: the degrees of freedom that move its body, too, from the root on, without itself."""

    body: int
    ancestors: tuple[int, ...]
    armature: Number
    damping: Number


@dataclass(frozen=True)
class Tree:
    """num_positions: nq. gravity: [3] in m/s²."""

    bodies: tuple[Body, ...]
    dofs: tuple[Dof, ...]
    num_positions: int
    gravity: Vector

    @property
    def entries(self) -> list[tuple[int, int]]:
        """(i, j) of the lower triangle's entries that can differ from 0: j is i, or an ancestor of i."""
        return [(i, j) for i, dof in enumerate(self.dofs) for j in (*dof.ancestors, i)]


def read_tree(model: mujoco.MjModel) -> Tree:
    """The model's tree."""
    bodies = tuple(_body(model, number) for number in range(model.nbody))
    dofs = tuple(_dof(model, number) for number in range(model.nv))
    return Tree(bodies, dofs, model.nq, _floats(model.opt.gravity))


def _body(model: mujoco.MjModel, number: int) -> Body:
    first = int(model.body_jntadr[number])
    joints = range(first, first + int(model.body_jntnum[number]))
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[number])
    principal = axes.reshape(3, 3)
    inertia = principal @ np.diag(model.body_inertia[number]) @ principal.T
    # Rounding leaves traces where a body is symmetric, and each would be an operation at every substep.
    inertia[np.abs(inertia) < 1e-12 * np.abs(inertia).max(initial=0.0)] = 0.0
    return Body(
        parent=int(model.body_parentid[number]),
        root=int(model.body_rootid[number]),
        position=_floats(model.body_pos[number]),
        quaternion=_floats(model.body_quat[number]),
        centre=_floats(model.body_ipos[number]),
        inertia=_floats(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
        mass=float(model.body_mass[number]),
        joints=tuple(_joint(model, joint) for joint in joints),
    )


def _joint(model: mujoco.MjModel, number: int) -> Joint:
    kind = _KINDS[int(model.jnt_type[number])]
    first = int(model.jnt_qposadr[number])
    positions = slice(first, first + {"free": 7, "ball": 4}.get(kind, 1))
    return Joint(
        kind=kind,
        qpos=first,
        dof=int(model.jnt_dofadr[number]),
        anchor=_floats(model.jnt_pos[number]),
        axis=_floats(model.jnt_axis[number]),
        reference=_floats(model.qpos0[positions]),
        spring=_floats(model.qpos_spring[positions]),
        stiffness=float(model.jnt_stiffness[number]),
    )


def _dof(model: mujoco.MjModel, number: int) -> Dof:
    ancestors = list[int]()
    above = int(model.dof_parentid[number])
    while above >= 0:
        ancestors.insert(0, above)
        above = int(model.dof_parentid[above])
    return Dof(
        body=int(model.dof_bodyid[number]),
        ancestors=tuple(ancestors),
        armature=float(model.dof_armature[number]),
        damping=float(model.dof_damping[number]),
    )


def _floats(values: np.ndarray) -> Vector:
    return [float(value) for value in values]
