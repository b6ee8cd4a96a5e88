"""The drag of a fluid on bodies, each taken for the box that has its inertia.

Source: MuJoCo's documentation, Computation, "Fluid forces", "Inertia model".
"""

from dataclasses import dataclass
from math import pi

import mujoco

from mujoco_compiled.fields import NOMINAL, Fields, Own, divided, is_zero
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    cross,
    maximum,
    product,
    rotate,
    sqrt,
    subtract,
    transpose,
)
from mujoco_compiled.smooth.dynamics import Motion, Wrenches
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.tree import Tree, is_passive_disabled, principal_axes


@dataclass(frozen=True)
class Drag:
    """axes: the box's, in the body's frame. Along each of them, a force of -(linear + quadratic · |v|) · v.

    linear: of viscosity; quadratic: of density; [6] each, of rotations and translations.
    """

    axes: Matrix
    linear: Vector
    quadratic: Vector


@dataclass(frozen=True)
class Fluid:
    """wind: its velocity, [3] in m/s. drags: by body."""

    wind: Vector
    drags: dict[int, Drag]


def read_fluid(model: mujoco.MjModel, own: Own = NOMINAL) -> Fluid:
    """The fluid in which the model moves; no drags without any. own: see `Fields`."""
    fields, found = Fields(model, own), Fluid([float(x) for x in model.opt.wind], {})
    if (model.opt.density or model.opt.viscosity) and not is_passive_disabled(fields):
        for body in range(1, model.nbody):
            if not is_zero(fields.number("body_mass", body)):
                found.drags[body] = _drag(fields, body)
    return found


def drag_forces(tree: Tree, fluid: Fluid, at: Poses, moving: Motion) -> Wrenches:
    """The drag on each body. The sum along the degrees of freedom is MuJoCo's `qfrc_fluid`."""
    return {body: _dragged(tree, fluid, body, at, moving) for body in fluid.drags}


def _dragged(tree: Tree, fluid: Fluid, body: int, at: Poses, moving: Motion) -> Vector:
    drag, velocity = fluid.drags[body], moving.velocities[body]
    arm = subtract(at.centres[body], moving.centres[tree.bodies[body].root])
    way = subtract(add(velocity[3:], cross(velocity[:3], arm)), fluid.wind)
    to_world = product(at.rotations[body], drag.axes)
    to_box = transpose(to_world)
    speeds = [*rotate(to_box, velocity[:3]), *rotate(to_box, way)]
    forces = [
        -((linear + quadratic * absolute(speed)) * speed)
        for linear, quadratic, speed in zip(drag.linear, drag.quadratic, speeds, strict=True)
    ]
    torque, force = rotate(to_world, forces[:3]), rotate(to_world, forces[3:])
    return [*add(torque, cross(arm, force)), *force]


def _drag(fields: Fields, body: int) -> Drag:
    """The drag of the box that has this mass and these moments of inertia."""
    option = fields.model.opt
    density, viscosity = float(option.density), float(option.viscosity)
    mass, moments = fields.number("body_mass", body), fields.row("body_inertia", body)

    def side(along: int, *across: int) -> Number:
        squared = moments[across[0]] + moments[across[1]] - moments[along]
        return divided(sqrt(6.0 * mass * maximum(squared, mujoco.mjMINVAL)), mass, 0.0)

    a, b, c = side(0, 1, 2), side(1, 0, 2), side(2, 0, 1)
    diameter = (a + b + c) * (1.0 / 3.0)
    turning, moving = pi * viscosity * (diameter * diameter * diameter), 3.0 * pi * viscosity * diameter
    fourth = [x * x * (x * x) for x in (a, b, c)]
    return Drag(
        axes=principal_axes(fields.model, body),
        linear=[turning] * 3 + [moving] * 3,
        quadratic=[
            density / 64.0 * a * (fourth[1] + fourth[2]),
            density / 64.0 * b * (fourth[0] + fourth[2]),
            density / 64.0 * c * (fourth[0] + fourth[1]),
            0.5 * density * b * c,
            0.5 * density * a * c,
            0.5 * density * a * b,
        ],
    )
