"""Passive forces: springs and dampers of joints, and what holds bodies against gravity.

Source: MuJoCo's documentation, Computation, "Passive forces".
"""

from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    absolute,
    cross,
    dot,
    maximum,
    normalized,
    polynomial,
    quaternion_product,
    scale,
    sqrt,
    subtract,
)
from mujoco_compiled.smooth.dynamics import Motion, Wrenches, projected
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.spatial import conjugate, rotation_vector
from mujoco_compiled.smooth.tree import JointConstants, Tree, acts


def passive_forces(tree: Tree, qpos: Vector, qvel: Vector) -> Vector:
    """[nv]: the joints' springs and dampers."""
    found = [damper_force(dof.damping, speed)[0] for dof, speed in zip(tree.dofs, qvel, strict=True)]
    for body in tree.bodies:
        for joint in body.joints:
            if acts(joint.stiffness):
                stretched = [_stiffened(joint.stiffness, one) for one in _stretches(joint, qpos)]
                for place, force in enumerate((x for one in stretched for x in one), joint.dof):
                    found[place] = found[place] - force
    return found


def damper_force(damping: Vector, speed: Number) -> tuple[Number, Number]:
    """A damper's force at a speed, and how it changes with it. damping: a polynomial of the speed's size."""
    size = absolute(speed) if len(damping) > 1 else 0.0
    slope = polynomial([power * x for power, x in enumerate(damping, 1)], size)
    return -(polynomial(damping, size) * speed), -slope


def weight_held(tree: Tree, at: Poses, moving: Motion) -> Vector:
    """[nv]: the forces of gravity compensation; empty where no body has any."""
    held = Wrenches()
    for number, body in enumerate(tree.bodies):
        if number and body.gravity_compensation:
            force = scale(tree.gravity, -(body.mass * body.gravity_compensation))
            arm = subtract(at.centres[number], moving.centres[body.root])
            held[number] = [*cross(arm, force), *force]
    return projected(tree, moving, held) if held else []


def _stiffened(stiffness: Vector, stretched: Vector) -> Vector:
    """How much a stretched spring resists, by a polynomial of a signed number or of a vector's length."""
    if len(stiffness) == 1:
        return scale(stretched, stiffness[0])
    is_scalar = len(stretched) == 1
    size = stretched[0] if is_scalar else sqrt(maximum(dot(stretched, stretched), 1e-30))
    return scale(stretched, polynomial(stiffness, size))


def _stretches(joint: JointConstants, qpos: Vector) -> list[Vector]:
    """How far each degree of freedom is from where the spring rests: a shift, and a rotation as a vector in
    rad."""
    place = joint.qpos
    if joint.kind in ("hinge", "slide"):
        return [[qpos[place] - joint.spring[0]]]
    shift = list[Vector]()
    if joint.kind == "free":
        shift.append(subtract(qpos[place : place + 3], joint.spring[:3]))
        place += 3
    turned = quaternion_product(conjugate(joint.spring[-4:]), normalized(qpos[place : place + 4]))
    return [*shift, rotation_vector(turned)]
