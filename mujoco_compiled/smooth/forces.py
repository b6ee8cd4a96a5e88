"""Passive forces: springs and dampers of joints, and what holds bodies against gravity.

Source: MuJoCo's documentation, Computation, "Passive forces".
"""

from mujoco_compiled.fields import is_zero
from mujoco_compiled.program.arithmetic import (
    Vector,
    cross,
    normalized,
    quaternion_product,
    scale,
    subtract,
)
from mujoco_compiled.smooth.dynamics import Motion, Wrenches, projected
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.spatial import conjugate, rotation_vector
from mujoco_compiled.smooth.tree import JointConstants, Tree


def passive_forces(tree: Tree, qpos: Vector, qvel: Vector) -> Vector:
    """[nv]: the joints' springs and dampers."""
    found: Vector = [-(dof.damping * speed) for dof, speed in zip(tree.dofs, qvel, strict=True)]
    for body in tree.bodies:
        for joint in body.joints:
            if not is_zero(joint.stiffness):
                for place, stretch in enumerate(_stretch(joint, qpos), joint.dof):
                    found[place] = found[place] - joint.stiffness * stretch
    return found


def weight_held(tree: Tree, at: Poses, moving: Motion) -> Vector:
    """[nv]: the forces of gravity compensation; empty where no body has any."""
    held = Wrenches()
    for number, body in enumerate(tree.bodies):
        if number and body.gravity_compensation:
            force = scale(tree.gravity, -(body.mass * body.gravity_compensation))
            arm = subtract(at.centres[number], moving.centres[body.root])
            held[number] = [*cross(arm, force), *force]
    return projected(tree, moving, held) if held else []


def _stretch(joint: JointConstants, qpos: Vector) -> Vector:
    """How far each degree of freedom is from where the spring rests; rotations as a vector in rad."""
    place = joint.qpos
    if joint.kind in ("hinge", "slide"):
        return [qpos[place] - joint.spring[0]]
    shift: Vector = []
    if joint.kind == "free":
        shift = subtract(qpos[place : place + 3], joint.spring[:3])
        place += 3
    turned = quaternion_product(conjugate(joint.spring[-4:]), normalized(qpos[place : place + 4]))
    return [*shift, *rotation_vector(turned)]
