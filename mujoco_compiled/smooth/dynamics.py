"""Inertia, velocities and bias forces of a tree.

Source: MuJoCo's documentation, Computation; Featherstone (2008), chapters 5 (recursive Newton-Euler) and 6
(composite rigid bodies).
"""

from dataclasses import dataclass

from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    cross,
    dot,
    scale,
    subtract,
    total,
    transpose,
)
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.spatial import about_centre, cross_force, cross_motion, momentum
from mujoco_compiled.smooth.tree import JointConstants, Tree

Entries = dict[tuple[int, int], Number]
# By body: a spatial force [6] about its tree's centre of mass.
Wrenches = dict[int, Vector]
_STILL = [0.0] * 6


@dataclass(frozen=True)
class Motion:
    """By degree of freedom: axes [6], MuJoCo's `cdof`, and their rates of change [6], `cdof_dot`.

    By body: inertias [10], `cinert`; velocities [6], `cvel`. By root: centres of mass [3] in m. All about the
    centre of mass of the body's tree.
    """

    axes: list[Vector]
    axis_rates: list[Vector]
    inertias: list[Vector]
    velocities: list[Vector]
    centres: dict[int, Vector]


def motion(tree: Tree, at: Poses, qvel: Vector) -> Motion:
    """qvel: [nv]."""
    centres = {root: centre_of(tree, at, root) for root in {body.root for body in tree.bodies[1:]}}
    found = Motion([], [], [_STILL + [0.0] * 4], [_STILL], centres)
    for number, body in list(enumerate(tree.bodies))[1:]:
        offset = subtract(at.centres[number], centres[body.root])
        found.inertias.append(about_centre(body.inertia, at.rotations[number], offset, body.mass))
        velocity = found.velocities[body.parent]
        for joint in body.joints:
            for axes in axes_of(joint, at, number, centres[body.root]):
                rates = [cross_motion(velocity, axis) for axis in axes]
                speeds = qvel[len(found.axes) : len(found.axes) + len(axes)]
                found.axes.extend(axes)
                found.axis_rates.extend(rates)
                for axis, speed in zip(axes, speeds, strict=True):
                    velocity = add(velocity, scale(axis, speed))
        found.velocities.append(velocity)
    return found


def mass_matrix(tree: Tree, moving: Motion) -> Entries:
    """M, the entries (i, j) of `Tree.entries`: MuJoCo's `qM`."""
    composite = _summed_to_the_root(tree, moving.inertias)
    found = Entries()
    for i, dof in enumerate(tree.dofs):
        force = momentum(composite[dof.body], moving.axes[i])
        for j in dof.ancestors:
            found[i, j] = dot(moving.axes[j], force)
        found[i, i] = dot(moving.axes[i], force) + dof.armature
    return found


def bias_forces(tree: Tree, moving: Motion, qvel: Vector, pushed: Wrenches | None = None) -> Vector:
    """[nv]: MuJoCo's `qfrc_bias`, of gravity, centrifugal and Coriolis accelerations.

    pushed: forces on bodies, which are subtracted, as `projected` would make them.
    """
    accelerations, forces = [[0.0, 0.0, 0.0, *scale(tree.gravity, -1.0)]], [_STILL]
    for number, body in list(enumerate(tree.bodies))[1:]:
        acceleration = accelerations[body.parent]
        for i, dof in enumerate(tree.dofs):
            if dof.body == number:
                acceleration = add(acceleration, scale(moving.axis_rates[i], qvel[i]))
        inertia, velocity = moving.inertias[number], moving.velocities[number]
        turning = cross_force(velocity, momentum(inertia, velocity))
        accelerations.append(acceleration)
        force = add(momentum(inertia, acceleration), turning)
        forces.append(subtract(force, pushed[number]) if pushed and number in pushed else force)
    return _along_axes(tree, moving, forces)


def accelerations(tree: Tree, moving: Motion, qvel: Vector, qacc: Vector, of_world: Vector) -> list[Vector]:
    """By body: its spatial acceleration [6] about its tree's centre of mass, MuJoCo's `cacc`.

    of_world: [3], in m/s².
    """
    found = [[0.0, 0.0, 0.0, *of_world]]
    for number, body in list(enumerate(tree.bodies))[1:]:
        acceleration = found[body.parent]
        for i, dof in enumerate(tree.dofs):
            if dof.body == number:
                acceleration = add(acceleration, scale(moving.axis_rates[i], qvel[i]))
                acceleration = add(acceleration, scale(moving.axes[i], qacc[i]))
        found.append(acceleration)
    return found


def projected(tree: Tree, moving: Motion, pushed: Wrenches) -> Vector:
    """[nv]: the forces on the degrees of freedom that forces on bodies make."""
    return _along_axes(tree, moving, [pushed.get(number, _STILL) for number in range(len(tree.bodies))])


def _along_axes(tree: Tree, moving: Motion, forces: list[Vector]) -> Vector:
    carried = _summed_to_the_root(tree, forces)
    return [dot(moving.axes[i], carried[dof.body]) for i, dof in enumerate(tree.dofs)]


def centre_of(tree: Tree, at: Poses, root: int) -> Vector:
    """The centre of mass [3] in m of a root's tree."""
    members = [number for number, body in enumerate(tree.bodies) if number and body.root == root]
    return [total(at.centres[number][k] * tree.bodies[number].share for number in members) for k in range(3)]


def axes_of(joint: JointConstants, at: Poses, body: int, centre: Vector) -> list[list[Vector]]:
    """The joint's axes [6] in groups: those of a group change with the velocity before the whole group."""
    arm = subtract(centre, at.anchors[joint.dof])
    unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    match joint.kind:
        case "slide":
            return [[[0.0, 0.0, 0.0, *at.axes[joint.dof]]]]
        case "hinge":
            axis = at.axes[joint.dof]
            return [[[*axis, *cross(axis, arm)]]]
        case "free" | "ball":
            turns = [[*axis, *cross(axis, arm)] for axis in transpose(at.rotations[body])]
            return [[[0.0, 0.0, 0.0, *axis] for axis in unit], turns] if joint.kind == "free" else [turns]


def _summed_to_the_root(tree: Tree, own: list[Vector]) -> list[Vector]:
    """By body: its own [k] and those of all bodies that it carries."""
    carried = list(own)
    for number in range(len(tree.bodies) - 1, 0, -1):
        above = tree.bodies[number].parent
        if above:
            carried[above] = add(carried[above], carried[number])
    return carried
