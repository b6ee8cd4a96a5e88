"""Joints and tendons at their limits.

Source: MuJoCo's documentation, Computation, "Constraint model".
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.constraints.laws import OneSided, RowGroup
from mujoco_compiled.constraints.solref import (
    SpringDamper,
    impedance_at,
    read_spring,
    reference_at,
    stiffness_at,
)
from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    dot,
    maximum,
    minimum,
    normalized,
    scale,
    select,
    sqrt,
)
from mujoco_compiled.smooth.paths import Linear, Path, Stretch
from mujoco_compiled.smooth.spatial import angle_of
from mujoco_compiled.smooth.tendons import path_of, read_tendons

_SMALLEST = 1e-30


@dataclass(frozen=True)
class Limit:
    """The range of a hinge, a slide or a tendon, in rad or m.

    is_narrow: whether both ends can be nearer than the margin. inverse_weight: MuJoCo's `dof_invweight0` or
    `tendon_invweight0`.
    """

    path: Path
    low: float
    high: float
    margin: float
    is_narrow: bool
    spring: SpringDamper
    inverse_weight: Number


@dataclass(frozen=True)
class BallLimit:
    """The angle in rad by which a ball joint may turn from its reference. qpos, dof: its first addresses."""

    qpos: int
    dof: int
    most: float
    margin: float
    spring: SpringDamper
    inverse_weight: Number


def read_limits(fields: Fields) -> tuple[Limit, ...]:
    """The limited hinges, slides and tendons."""
    model = fields.model
    joints = [_limit(fields, joint) for joint in _limited(model) if not _is_ball(model, joint)]
    return (*joints, *_tendon_limits(fields))


def read_ball_limits(fields: Fields) -> tuple[BallLimit, ...]:
    """The limited ball joints."""
    model = fields.model
    return tuple(_ball_limit(fields, joint) for joint in _limited(model) if _is_ball(model, joint))


def limit_rows(limit: Limit, stretched: Stretch, qvel: Vector) -> list[RowGroup]:
    """The nearer end of the range; both where both can be active at once. stretched: of the limit's path."""
    above, below = stretched.length - limit.low, limit.high - stretched.length
    ends = [(above, 1.0), (below, -1.0)]
    if not limit.is_narrow:
        ends = [(minimum(above, below), select(above < below, 1.0, -1.0))]
    return [_limit_row(limit, stretched, qvel, *end) for end in ends]


def _limit_row(limit: Limit, stretched: Stretch, qvel: Vector, room: Number, sign: Number) -> RowGroup:
    """room: how far the end is away. sign: of the direction away from it."""
    distance = room - limit.margin
    impedance = impedance_at(limit.spring.impedance, distance)
    stiffness = stiffness_at(impedance, limit.inverse_weight, distance)
    reference = reference_at(limit.spring, impedance, distance, sign * stretched.rate(qvel))
    direction = {dof: sign * coefficient for dof, coefficient in stretched.moment.items()}
    return RowGroup([direction], [reference], OneSided(stiffness))


def ball_limit_row(limit: BallLimit, qpos: Vector, qvel: Vector) -> RowGroup:
    """Against the turn that the joint has made, about its axis."""
    real, *imaginary = normalized(qpos[limit.qpos : limit.qpos + 4])
    # The quaternion of the same turn, by less than half a circle.
    sign = select(real < 0.0, -1.0, 1.0)
    length = sqrt(maximum(dot(imaginary, imaginary), _SMALLEST))
    axis = scale(imaginary, sign / length)
    distance = limit.most - 2.0 * angle_of(length, sign * real) - limit.margin
    direction = {limit.dof + k: -x for k, x in enumerate(axis)}
    speed = dot(list(direction.values()), qvel[limit.dof : limit.dof + 3])
    impedance = impedance_at(limit.spring.impedance, distance)
    stiffness = stiffness_at(impedance, limit.inverse_weight, distance)
    return RowGroup(
        [direction], [reference_at(limit.spring, impedance, distance, speed)], OneSided(stiffness)
    )


def _limited(model: mujoco.MjModel) -> list[int]:
    return [int(joint) for joint in np.flatnonzero(model.jnt_limited)]


def _is_ball(model: mujoco.MjModel, joint: int) -> bool:
    return int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_BALL)


def _limit(fields: Fields, joint: int) -> Limit:
    model = fields.model
    dof = int(model.jnt_dofadr[joint])
    return Limit(
        path=Linear({int(model.jnt_qposadr[joint]): 1.0}, {dof: 1.0}),
        low=float(model.jnt_range[joint, 0]),
        high=float(model.jnt_range[joint, 1]),
        margin=float(model.jnt_margin[joint]),
        is_narrow=bool(np.ptp(model.jnt_range[joint]) < 2.0 * model.jnt_margin[joint]),
        spring=read_spring(fields.row("jnt_solref", joint), model.jnt_solimp[joint], model.opt.timestep),
        inverse_weight=fields.number("dof_invweight0", dof),
    )


def _tendon_limits(fields: Fields) -> Iterator[Limit]:
    model = fields.model
    for number, tendon in enumerate(read_tendons(model, fields.own)):
        if model.tendon_limited[number]:
            solimp = model.tendon_solimp_lim[number]
            yield Limit(
                path=path_of(tendon, number),
                low=float(model.tendon_range[number, 0]),
                high=float(model.tendon_range[number, 1]),
                margin=float(model.tendon_margin[number]),
                is_narrow=bool(np.ptp(model.tendon_range[number]) < 2.0 * model.tendon_margin[number]),
                spring=read_spring(fields.row("tendon_solref_lim", number), solimp, model.opt.timestep),
                inverse_weight=fields.number("tendon_invweight0", number),
            )


def _ball_limit(fields: Fields, joint: int) -> BallLimit:
    model = fields.model
    dof = int(model.jnt_dofadr[joint])
    return BallLimit(
        qpos=int(model.jnt_qposadr[joint]),
        dof=dof,
        most=float(model.jnt_range[joint].max()),
        margin=float(model.jnt_margin[joint]),
        spring=read_spring(fields.row("jnt_solref", joint), model.jnt_solimp[joint], model.opt.timestep),
        inverse_weight=fields.number("dof_invweight0", dof),
    )
