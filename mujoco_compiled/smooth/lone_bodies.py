"""Free bodies that carry no joints, such as a ball or a box to push, under MuJoCo's `implicitfast`.

That leaves out how centrifugal forces change with velocities, but not for these bodies (measured in MuJoCo
3.17), whose matrix then is not symmetric.
Source: MuJoCo's documentation, Computation, "Numerical integration".
"""

from dataclasses import dataclass

from mujoco_compiled.program.arithmetic import (
    Matrix,
    Vector,
    add,
    cross,
    dot,
    scale,
    subtract,
    total,
    transpose,
)
from mujoco_compiled.smooth.dynamics import Entries, Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.spatial import momentum
from mujoco_compiled.smooth.tree import Tree


@dataclass(frozen=True)
class LoneBody:
    """parts: the body and those that are fixed to it. dof: its first."""

    body: int
    parts: tuple[int, ...]
    dof: int


def read_lone_bodies(tree: Tree) -> tuple[LoneBody, ...]:
    """Free bodies whose trees have no other joint."""
    found = list[LoneBody]()
    for number, body in enumerate(tree.bodies):
        if [joint.kind for joint in body.joints] == ["free"]:
            parts = [part for part, other in enumerate(tree.bodies) if part and other.root == body.root]
            if sum(dof.body in parts for dof in tree.dofs) == 6:
                found.append(LoneBody(number, tuple(parts), body.joints[0].dof))
    return tuple(found)


def lone_accelerations(
    lone: LoneBody, at: Poses, moving: Motion, inertia: Entries, force: Vector, timestep: float
) -> Vector:
    """[6]: the acceleration by which the body's velocity changes.

    inertia: M and h times dampers. force: [nv], M times the acceleration before.
    """
    dofs = range(lone.dof, lone.dof + 6)
    matrix = [[inertia[max(i, j), min(i, j)] for j in dofs] for i in dofs]
    for k, slopes in enumerate(_slopes(lone, at, moving)):
        for i, slope in enumerate(slopes):
            matrix[i][3 + k] = matrix[i][3 + k] + timestep * slope
    return _solved(matrix, [force[i] for i in dofs])


def _slopes(lone: LoneBody, at: Poses, moving: Motion) -> list[Vector]:
    """By axis of the body: how its centrifugal forces [6] change with its speed about the axis.

    About its centre of mass they are w × (I w), and its mass times w × (w × r) at the distance r from where
    its joint is.
    """
    inertia = [
        total(several) for several in zip(*(moving.inertias[part] for part in lone.parts), strict=True)
    ]
    mass, axes = inertia[9], transpose(at.rotations[lone.body])
    turning = moving.velocities[lone.body][:3]
    arm = subtract(moving.centres[lone.parts[0]], at.positions[lone.body])

    def moment(turn: Vector) -> Vector:
        return momentum([*inertia[:6], 0.0, 0.0, 0.0, mass], [*turn, 0.0, 0.0, 0.0])[:3]

    found = list[Vector]()
    for axis in axes:
        push = add(cross(axis, cross(turning, arm)), cross(turning, cross(axis, arm)))
        push = scale(push, mass)
        twist = add(cross(axis, moment(turning)), cross(turning, moment(axis)))
        twist = add(twist, cross(arm, push))
        found.append([*push, *(dot(other, twist) for other in axes)])
    return found


def _solved(matrix: Matrix, right: Vector) -> Vector:
    """x with A x = right, by elimination without pivots: A is nearly M, which needs none."""
    rows = [[*row, one] for row, one in zip(matrix, right, strict=True)]
    size = len(rows)
    for k in range(size):
        inverse = 1.0 / rows[k][k]
        rows[k] = [x * inverse for x in rows[k]]
        for i in range(k + 1, size):
            factor = rows[i][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    found: Vector = [0.0] * size
    for k in reversed(range(size)):
        found[k] = rows[k][size] - dot(rows[k][k + 1 : size], found[k + 1 :])
    return found
