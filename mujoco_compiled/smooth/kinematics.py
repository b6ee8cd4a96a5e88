"""Where bodies and joints are. Source: MuJoCo's documentation, Computation, "Forward kinematics"."""

from dataclasses import dataclass

from mujoco_compiled.program.arithmetic import (
    Matrix,
    Vector,
    add,
    normalized,
    quaternion_product,
    rotate,
    rotation_about,
    rotation_matrix,
    scale,
    subtract,
)
from mujoco_compiled.smooth.tree import JointConstants, Tree


@dataclass(frozen=True)
class Poses:
    """By body, in the world: positions [3] in m, rotations as [3][3] and as quaternions [4], and centres of
    mass [3] in m.

    By the address of a joint's first degree of freedom: anchors [3] in m and axes [3], in the world.
    """

    positions: list[Vector]
    rotations: list[Matrix]
    quaternions: list[Vector]
    centres: list[Vector]
    anchors: dict[int, Vector]
    axes: dict[int, Vector]


@dataclass
class _Frame:
    position: Vector
    quaternion: Vector


def poses(tree: Tree, qpos: Vector) -> Poses:
    """qpos: [nq]; quaternions in it need not have length 1."""
    found = Poses([], [], [], [], {}, {})
    for number, body in enumerate(tree.bodies):
        if number == 0:
            frame = _Frame(body.position, body.quaternion)
        else:
            above = found.rotations[body.parent]
            frame = _Frame(
                add(found.positions[body.parent], rotate(above, body.position)),
                quaternion_product(found.quaternions[body.parent], body.quaternion),
            )
        for joint in body.joints:
            _move(frame, joint, qpos, found)
        rotation = rotation_matrix(frame.quaternion)
        found.quaternions.append(frame.quaternion)
        found.positions.append(frame.position)
        found.rotations.append(rotation)
        found.centres.append(add(frame.position, rotate(rotation, body.centre)))
    return found


def _move(frame: _Frame, joint: JointConstants, qpos: Vector, found: Poses) -> None:
    """Put the frame where the joint's position puts it, and note the joint's anchor and axis."""
    first = joint.qpos
    if joint.kind == "free":
        frame.position, frame.quaternion = qpos[first : first + 3], normalized(qpos[first + 3 : first + 7])
        found.anchors[joint.dof] = frame.position
        return
    rotation = rotation_matrix(frame.quaternion)
    anchor = add(frame.position, rotate(rotation, joint.anchor))
    axis = rotate(rotation, joint.axis)
    found.anchors[joint.dof], found.axes[joint.dof] = anchor, axis
    if joint.kind == "slide":
        frame.position = add(frame.position, scale(axis, qpos[first] - joint.reference[0]))
        return
    if joint.kind == "hinge":
        turn = rotation_about(joint.axis, qpos[first] - joint.reference[0])
    else:
        turn = normalized(qpos[first : first + 4])
    frame.quaternion = quaternion_product(frame.quaternion, turn)
    frame.position = subtract(anchor, rotate(rotation_matrix(frame.quaternion), joint.anchor))
