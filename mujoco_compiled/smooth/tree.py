"""A model as the stages read it: bodies, joints and degrees of freedom in the order of the tree."""

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from mujoco_compiled.fields import NOMINAL, Fields, Own, divided, is_zero
from mujoco_compiled.program.arithmetic import Matrix, Number, Vector, dot, total

JointKind = Literal["free", "ball", "slide", "hinge"]
# The lowest and the highest value.
Range = tuple[Number, Number]
_KINDS: tuple[JointKind, ...] = ("free", "ball", "slide", "hinge")  # in MuJoCo's order


@dataclass(frozen=True)
class JointConstants:
    """qpos, dof: addresses of its first position and velocity. anchor, axis: in the body's frame, in m.

    reference, spring: positions (qpos0, qpos_spring) from its address on. stiffness: a polynomial of how far
    the spring is stretched, in N/m or N m/rad.
    """

    kind: JointKind
    qpos: int
    dof: int
    anchor: Vector
    axis: Vector
    reference: Vector
    spring: Vector
    stiffness: Vector


@dataclass(frozen=True)
class BodyConstants:
    """parent, root: numbers of bodies; 0 is the world, which has neither joints nor mass.

    position [3] in m and quaternion [4]: in the parent's frame. centre: of mass [3], in the body's frame.
    inertia: about the centre, along the body's axes: xx, yy, zz, xy, xz, yz in kg m². mass: kg. share: of the
    whole tree's mass. gravity_compensation: the share of its weight that a force holds. moved_by: degrees of
    freedom, from the root on.
    """

    parent: int
    root: int
    position: Vector
    quaternion: Vector
    centre: Vector
    inertia: Vector
    mass: Number
    share: Number
    gravity_compensation: float
    joints: tuple[JointConstants, ...]
    moved_by: tuple[int, ...]


@dataclass(frozen=True)
class Dof:
    """ancestors: the degrees of freedom that move its body, too, from the root on, without itself.

    damping: a polynomial of the speed, in N s/m or N m s/rad.
    actuator_range: bounds of all actuators' force together; None without. holds_weight: whether the force of
    gravity compensation counts as an actuator's.
    """

    body: int
    ancestors: tuple[int, ...]
    armature: Number
    damping: Vector
    actuator_range: Range | None
    holds_weight: bool


@dataclass(frozen=True)
class Tree:
    """gravity: [3] in m/s²."""

    bodies: tuple[BodyConstants, ...]
    dofs: tuple[Dof, ...]
    gravity: Vector

    @property
    def entries(self) -> list[tuple[int, int]]:
        """(i, j) of the lower triangle's entries that can differ from 0: j is i, or an ancestor of i."""
        return [(i, j) for i, dof in enumerate(self.dofs) for j in (*dof.ancestors, i)]


def read_tree(model: mujoco.MjModel, own: Own = NOMINAL) -> Tree:
    """The model's tree. own: see `Fields`."""
    fields = Fields(model, own)
    shares = _shares(fields)
    bodies = tuple(_body(fields, number, shares[number]) for number in range(model.nbody))
    dofs = tuple(_dof(fields, number) for number in range(model.nv))
    weightless = fields.disables(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return Tree(bodies, dofs, [0.0] * 3 if weightless else fields.row("opt.gravity"))


def principal_axes(model: mujoco.MjModel, body: int) -> Matrix:
    """The rotation from the inertia's principal axes to the body's."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    return [_floats(row) for row in axes.reshape(3, 3)]


def is_passive_disabled(fields: Fields) -> bool:
    """Without springs and dampers, MuJoCo computes no passive force at all."""
    bit = mujoco.mjtDisableBit
    return fields.disables(bit.mjDSBL_SPRING) and fields.disables(bit.mjDSBL_DAMPER)


def law(fields: Fields, name: str, number: int) -> Vector:
    """The polynomial of a spring or a damper, such as `dof_damping`, without zeros at its end but for one."""
    whole = [fields.number(name, number), *_floats(getattr(fields.model, f"{name}poly")[number])]
    while len(whole) > 1 and is_zero(whole[-1]):
        whole.pop()
    return whole


def acts(polynomial: Vector) -> bool:
    """Whether a spring or a damper is there."""
    return not all(is_zero(x) for x in polynomial)


def moved_by(model: mujoco.MjModel, body: int) -> tuple[int, ...]:
    """The degrees of freedom that move the body, from the root on."""
    while body and not model.body_dofnum[body]:
        body = int(model.body_parentid[body])
    if not body:
        return ()
    last = int(model.body_dofadr[body] + model.body_dofnum[body]) - 1
    return (*_ancestors(model, last), last)


def _ancestors(model: mujoco.MjModel, dof: int) -> tuple[int, ...]:
    above = int(model.dof_parentid[dof])
    return () if above < 0 else (*_ancestors(model, above), above)


def _shares(fields: Fields) -> list[Number]:
    """By body: its share of its tree's mass. A tree without mass has its centre in its root."""
    roots = [int(root) for root in fields.model.body_rootid]
    masses = [fields.number("body_mass", number) for number in range(len(roots))]
    masses[0] = 0.0
    found = list[Number]()
    for number, root in enumerate(roots):
        whole = total(mass for mass, other in zip(masses, roots, strict=True) if other == root)
        found.append(divided(masses[number], whole, float(number == root)))
    return found


def _body(fields: Fields, number: int, share: Number) -> BodyConstants:
    model = fields.model
    first = int(model.body_jntadr[number])
    joints = range(first, first + int(model.body_jntnum[number]))
    is_world = number == 0
    return BodyConstants(
        parent=int(model.body_parentid[number]),
        root=int(model.body_rootid[number]),
        position=[0.0] * 3 if is_world else fields.row("body_pos", number),
        quaternion=[1.0, 0.0, 0.0, 0.0] if is_world else fields.row("body_quat", number),
        centre=fields.row("body_ipos", number),
        inertia=_inertia(fields, number),
        mass=fields.number("body_mass", number),
        share=share,
        gravity_compensation=0.0 if is_passive_disabled(fields) else float(model.body_gravcomp[number]),
        joints=tuple(_joint(fields, joint) for joint in joints),
        moved_by=moved_by(model, number),
    )


def _inertia(fields: Fields, number: int) -> Vector:
    """About the centre, along the body's axes: xx, yy, zz, xy, xz, yz."""
    axes, moments = principal_axes(fields.model, number), fields.row("body_inertia", number)
    largest = float(fields.model.body_inertia[number].max())

    def entry(i: int, j: int) -> Number:
        # Rounding leaves traces where a body is symmetric, and each would be an operation at every substep.
        weights = [x * y if abs(x * y) > 1e-12 else 0.0 for x, y in zip(axes[i], axes[j], strict=True)]
        value = dot(weights, moments)
        return 0.0 if isinstance(value, float) and abs(value) < 1e-12 * largest else value

    return [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)]


def _joint(fields: Fields, number: int) -> JointConstants:
    model = fields.model
    kind = _KINDS[int(model.jnt_type[number])]
    first = int(model.jnt_qposadr[number])
    positions = slice(first, first + {"free": 7, "ball": 4}.get(kind, 1))
    springless = fields.disables(mujoco.mjtDisableBit.mjDSBL_SPRING)
    return JointConstants(
        kind=kind,
        qpos=first,
        dof=int(model.jnt_dofadr[number]),
        anchor=_floats(model.jnt_pos[number]),
        axis=_floats(model.jnt_axis[number]),
        reference=_floats(model.qpos0[positions]),
        spring=_floats(model.qpos_spring[positions]),
        stiffness=[] if springless else law(fields, "jnt_stiffness", number),
    )


def _dof(fields: Fields, number: int) -> Dof:
    model = fields.model
    joint = int(model.dof_jntid[number])
    undamped = fields.disables(mujoco.mjtDisableBit.mjDSBL_DAMPER)
    low, high = _floats(model.jnt_actfrcrange[joint])
    return Dof(
        body=int(model.dof_bodyid[number]),
        ancestors=_ancestors(model, number),
        armature=fields.number("dof_armature", number),
        damping=[] if undamped else law(fields, "dof_damping", number),
        actuator_range=(low, high) if model.jnt_actfrclimited[joint] else None,
        holds_weight=bool(model.jnt_actgravcomp[joint]),
    )


def _floats(values: np.ndarray) -> Vector:
    return [float(value) for value in values]
