"""Joints at their limits.

Source: MuJoCo's documentation, Computation, "Constraint model".
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from core.physics.compiled.arithmetic import (
    Number,
    Vector,
    cosine,
    dot,
    maximum,
    minimum,
    normalized,
    scale,
    select,
    sine,
    sqrt,
)
from core.physics.compiled.fields import Fields
from core.physics.compiled.laws import OneSided
from core.physics.compiled.rows import Group
from core.physics.compiled.softness import (
    Softness,
    impedance_at,
    read_softness,
    reference_at,
    stiffness_at,
)

_SMALLEST = 1e-30


@dataclass(frozen=True)
class Limit:
    """A hinge's or slide's range in rad or m. inverse_weight: MuJoCo's `dof_invweight0`."""

    qpos: int
    dof: int
    low: float
    high: float
    margin: float
    softness: Softness
    inverse_weight: Number


@dataclass(frozen=True)
class BallLimit:
    """The angle in rad by which a ball joint may turn from its reference. qpos, dof: its first addresses."""

    qpos: int
    dof: int
    most: float
    margin: float
    softness: Softness
    inverse_weight: Number


def read_limits(fields: Fields) -> tuple[Limit, ...]:
    """The limited hinges and slides."""
    model = fields.model
    return tuple(_limit(fields, joint) for joint in _limited(model) if not _is_ball(model, joint))


def read_ball_limits(fields: Fields) -> tuple[BallLimit, ...]:
    """The limited ball joints."""
    model = fields.model
    return tuple(_ball_limit(fields, joint) for joint in _limited(model) if _is_ball(model, joint))


def limit_row(limit: Limit, qpos: Vector, qvel: Vector) -> Group:
    """The nearer end of the range: both are never active at once."""
    above, below = qpos[limit.qpos] - limit.low, limit.high - qpos[limit.qpos]
    sign = select(above < below, 1.0, -1.0)
    distance = minimum(above, below) - limit.margin
    impedance = impedance_at(limit.softness.impedance, distance)
    stiffness = stiffness_at(impedance, limit.inverse_weight, distance)
    reference = reference_at(limit.softness, impedance, distance, sign * qvel[limit.dof])
    return Group([{limit.dof: sign}], [reference], OneSided(stiffness))


def ball_limit_row(limit: BallLimit, qpos: Vector, qvel: Vector) -> Group:
    """Against the turn that the joint has made, about its axis."""
    real, *imaginary = normalized(qpos[limit.qpos : limit.qpos + 4])
    # The quaternion of the same turn, by less than half a circle.
    sign = select(real < 0.0, -1.0, 1.0)
    length = sqrt(maximum(dot(imaginary, imaginary), _SMALLEST))
    axis = scale(imaginary, sign / length)
    distance = limit.most - 2.0 * _angle(length, sign * real) - limit.margin
    direction = {limit.dof + k: -x for k, x in enumerate(axis)}
    speed = dot(list(direction.values()), qvel[limit.dof : limit.dof + 3])
    impedance = impedance_at(limit.softness.impedance, distance)
    stiffness = stiffness_at(impedance, limit.inverse_weight, distance)
    return Group([direction], [reference_at(limit.softness, impedance, distance, speed)], OneSided(stiffness))


def _angle(sine_of: Number, cosine_of: Number) -> Number:
    """The angle, from 0 to a quarter of a circle in rad, with this sine and cosine."""
    angle = (0.5 * np.pi) * (sine_of / (sine_of + cosine_of))
    # That is less than 0.07 away; each repetition leaves a sixth of the third power.
    for _ in range(2):
        angle = angle + (sine_of * cosine(angle) - cosine_of * sine(angle))
    return angle


def _limited(model: mujoco.MjModel) -> list[int]:
    return [int(joint) for joint in np.flatnonzero(model.jnt_limited)]


def _is_ball(model: mujoco.MjModel, joint: int) -> bool:
    return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_BALL)


def _limit(fields: Fields, joint: int) -> Limit:
    model = fields.model
    dof = int(model.jnt_dofadr[joint])
    return Limit(
        qpos=int(model.jnt_qposadr[joint]),
        dof=dof,
        low=float(model.jnt_range[joint, 0]),
        high=float(model.jnt_range[joint, 1]),
        margin=float(model.jnt_margin[joint]),
        softness=read_softness(fields.row("jnt_solref", joint), model.jnt_solimp[joint], model.opt.timestep),
        inverse_weight=fields.number("dof_invweight0", dof),
    )


def _ball_limit(fields: Fields, joint: int) -> BallLimit:
    model = fields.model
    dof = int(model.jnt_dofadr[joint])
    return BallLimit(
        qpos=int(model.jnt_qposadr[joint]),
        dof=dof,
        most=float(model.jnt_range[joint].max()),
        margin=float(model.jnt_margin[joint]),
        softness=read_softness(fields.row("jnt_solref", joint), model.jnt_solimp[joint], model.opt.timestep),
        inverse_weight=fields.number("dof_invweight0", dof),
    )
