"""One substep of a model, from its stages.

Source: MuJoCo's documentation, Computation, "Simulation pipeline" and "Numerical integration".
"""

from dataclasses import dataclass

import mujoco

from core.physics.compiled.arithmetic import (
    Number,
    Vector,
    add,
    cosine,
    dot,
    maximum,
    normalized,
    quaternion_product,
    scale,
    sine,
    sqrt,
)
from core.physics.compiled.constraints import Constraints, State, constraint_rows, read_constraints
from core.physics.compiled.dynamics import bias_forces, mass_matrix, motion
from core.physics.compiled.factor import factorize, solve
from core.physics.compiled.forces import Actuator, actuator_forces, passive_forces, read_actuators
from core.physics.compiled.kinematics import poses
from core.physics.compiled.loop import repeat
from core.physics.compiled.solver import Problem, Settings, acceleration, constraint_force
from core.physics.compiled.tree import Tree, read_tree


@dataclass(frozen=True)
class Model:
    """timestep: in s. implicit_damping: Euler's method takes the dampers' force at the end of the substep."""

    tree: Tree
    actuators: tuple[Actuator, ...]
    constraints: Constraints
    timestep: float
    implicit_damping: bool
    solver: Settings


@dataclass(frozen=True)
class Moved:
    """qpos: [nq]. qvel: [nv]. qacc: [nv], where the next substep's solver begins."""

    qpos: Vector
    qvel: Vector
    qacc: Vector


def read_model(model: mujoco.MjModel) -> Model:
    """The model as the stages read it."""
    is_explicit = bool(model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    return Model(
        tree=read_tree(model),
        actuators=read_actuators(model),
        constraints=read_constraints(model),
        timestep=float(model.opt.timestep),
        implicit_damping=bool(model.dof_damping.any()) and not is_explicit,
        solver=Settings(
            iterations=int(model.opt.iterations),
            line_search_iterations=int(model.opt.ls_iterations),
            tolerance=float(model.opt.tolerance),
            line_search_tolerance=float(model.opt.ls_tolerance),
            mean_inertia=float(model.stat.meaninertia),
        ),
    )


def control_step(
    model: Model, num_substeps: int, qpos: Vector, qvel: Vector, qacc: Vector, ctrl: Vector
) -> Moved:
    """The state after some substeps under a control [nu] that stays the same."""

    def body(carried: list[Number]) -> tuple[list[Number], Number]:
        moved = substep(model, *_parted(carried, len(qpos), len(qvel)), ctrl)
        return [*moved.qpos, *moved.qvel, *moved.qacc], True

    return Moved(*_parted(repeat(num_substeps, body, [*qpos, *qvel, *qacc]), len(qpos), len(qvel)))


def substep(model: Model, qpos: Vector, qvel: Vector, qacc: Vector, ctrl: Vector) -> Moved:
    """The state one timestep later under a control [nu]. qacc: [nv], the last substep's."""
    tree = model.tree
    at = poses(tree, qpos)
    moving = motion(tree, at, qvel)
    mass = mass_matrix(tree, moving)
    _, driven = actuator_forces(model.actuators, qpos, qvel, ctrl)
    passive = passive_forces(tree, qpos, qvel)
    bias = bias_forces(tree, moving, qvel)
    force = [x + y - z for x, y, z in zip(passive, driven, bias, strict=True)]
    free = solve(tree, factorize(tree, mass), force)
    rows = constraint_rows(tree, model.constraints, at, moving, State(qpos, qvel))
    problem = Problem(tree, mass, force, free, rows)
    found = acceleration(problem, qacc, model.solver)
    integrated = found
    if model.implicit_damping:
        damped = dict(mass)
        for i, dof in enumerate(tree.dofs):
            damped[i, i] = damped[i, i] + model.timestep * dof.damping
        integrated = solve(tree, factorize(tree, damped), add(force, constraint_force(problem, found)))
    after = add(qvel, scale(integrated, model.timestep))
    return Moved(_integrated(tree, qpos, after, model.timestep), after, found)


def _parted(values: list[Number], num_positions: int, num_speeds: int) -> tuple[Vector, Vector, Vector]:
    """Positions, velocities and accelerations."""
    end = num_positions + num_speeds
    return values[:num_positions], values[num_positions:end], values[end:]


def _integrated(tree: Tree, qpos: Vector, qvel: Vector, timestep: float) -> Vector:
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
