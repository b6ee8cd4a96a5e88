"""Bodies that are tied together: MuJoCo's `connect` and `weld`, between bodies or sites.

A `connect` keeps two points together, a `weld` the axes of two frames, too. Rows are the world's three axes,
and for a weld the imaginary part of the quaternion between the frames, which is half the turn where that is
small.
Source: MuJoCo's documentation, Computation, "Constraint model", "Equality"; XML reference, "equality/connect"
and "equality/weld". Measured in MuJoCo 3.17: the impedance is that of the length of the whole violation, and
the wanted acceleration has the term -dJ/dt v.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.constraints.laws import Direction, RowGroup, TwoSided
from mujoco_compiled.constraints.solref import (
    SpringDamper,
    full_stiffness,
    impedance_at,
    read_spring,
    reference_at,
)
from mujoco_compiled.fields import Fields, is_zero
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    cross,
    dot,
    quaternion_product,
    rotate,
    rotation_matrix,
    scale,
    sqrt,
    subtract,
    total,
)
from mujoco_compiled.smooth.dynamics import Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.spatial import conjugate
from mujoco_compiled.smooth.tree import Tree

_UPRIGHT = [1.0, 0.0, 0.0, 0.0]


@dataclass(frozen=True)
class Attachment:
    """The frame at which a body is tied. position: [3] in the body's frame, in m. quaternion: [4] in it."""

    body: int
    position: Vector
    quaternion: Vector


@dataclass(frozen=True)
class Tie:
    """Two attachments that are to be one.

    torque_scale: of the rows that keep the axes together, MuJoCo's `torquescale` in m; None: nothing does.
    inverse_weights: MuJoCo's `body_invweight0` of both bodies, of translations and of turns.
    """

    one: Attachment
    other: Attachment
    torque_scale: float | None
    spring: SpringDamper
    inverse_weights: tuple[Number, Number]


def read_ties(fields: Fields) -> tuple[Tie, ...]:
    """The connects and welds that are active from the start."""
    model, kinds = fields.model, (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
    return tuple(
        _tie(fields, int(i)) for i in np.flatnonzero(model.eq_active0 & np.isin(model.eq_type, kinds))
    )


def tie_rows(tree: Tree, tie: Tie, at: Poses, moving: Motion, qvel: Vector) -> list[RowGroup]:
    """A group for translations and one for turns, each as far as a degree of freedom changes it."""
    sides = [_side(tree, end, at, moving, qvel) for end in (tie.one, tie.other)]
    parts = [_apart(sides)]
    if tie.torque_scale is not None:
        parts.append(_turned(sides, tie.torque_scale))
    violation = [x for part in parts for x in part.violation]
    impedance = impedance_at(tie.spring.impedance, sqrt(dot(violation, violation)))
    return [
        _group(part, tie.spring, impedance, weight)
        for part, weight in zip(parts, tie.inverse_weights, strict=False)
        if part.directions[0]
    ]


@dataclass(frozen=True)
class _Side:
    """An attachment in the world, and how it moves.

    position, velocity: [3]. quaternion: [4]. turning: its angular velocity [3]. drift, turn_drift: the
    accelerations [3] of both where no velocity of a joint changes. moves: by degree of freedom, the velocity
    [3] and the angular velocity [3] that it gives.
    """

    position: Vector
    quaternion: Vector
    velocity: Vector
    turning: Vector
    drift: Vector
    turn_drift: Vector
    moves: dict[int, tuple[Vector, Vector]]


@dataclass(frozen=True)
class _Part:
    """By row: how far the attachments are apart, how fast, with which acceleration where no velocity of a
    joint changes, and how each degree of freedom changes it."""

    violation: Vector
    speed: Vector
    drift: Vector
    directions: list[Direction]


def _side(tree: Tree, end: Attachment, at: Poses, moving: Motion, qvel: Vector) -> _Side:
    position = add(at.positions[end.body], rotate(at.rotations[end.body], end.position))
    quaternion = quaternion_product(at.quaternions[end.body], end.quaternion)
    if not end.body:
        still = [0.0] * 3
        return _Side(position, quaternion, still, still, still, still, {})
    arm = subtract(position, moving.centres[tree.bodies[end.body].root])

    def at_point(motion: Vector) -> Vector:
        return add(motion[3:], cross(motion[:3], arm))

    dofs = tree.bodies[end.body].moved_by
    rates = [scale(moving.axis_rates[i], qvel[i]) for i in dofs]
    drift = [total(numbers) for numbers in zip(*rates, strict=True)] or [0.0] * 6
    turning, velocity = moving.velocities[end.body][:3], at_point(moving.velocities[end.body])
    return _Side(
        position,
        quaternion,
        velocity,
        turning,
        # A spatial acceleration is that of what passes through the point; this is that of the point itself.
        drift=add(at_point(drift), cross(turning, velocity)),
        turn_drift=drift[:3],
        moves={i: (at_point(moving.axes[i]), moving.axes[i][:3]) for i in dofs},
    )


def _apart(sides: list[_Side]) -> _Part:
    """From the second point to the first, along the world's axes."""
    one, other = sides
    still = [0.0] * 3
    differences = {
        i: subtract(one.moves.get(i, (still,))[0], other.moves.get(i, (still,))[0])
        for i in sorted({*one.moves, *other.moves})
    }
    return _Part(
        subtract(one.position, other.position),
        subtract(one.velocity, other.velocity),
        subtract(one.drift, other.drift),
        [{i: way[k] for i, way in differences.items()} for k in range(3)],
    )


def _turned(sides: list[_Side], torque_scale: float) -> _Part:
    """From the second frame to the first, in the second: with the quaternion e between them and the angular
    velocity w between them, de/dt = w e / 2."""
    one, other = sides
    between = quaternion_product(conjugate(other.quaternion), one.quaternion)
    real, imaginary = between[0], between[1:]
    rotation = rotation_matrix(other.quaternion)
    axes = [
        rotate(rotation, scale(add(scale(unit, real), cross(imaginary, unit)), 0.5 * torque_scale))
        for unit in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    ]
    turning = subtract(one.turning, other.turning)
    changing = subtract(subtract(one.turn_drift, other.turn_drift), cross(other.turning, turning))
    bent = scale(imaginary, -0.25 * torque_scale * dot(turning, turning))
    # What moves both bodies turns both alike.
    turns = {i: turn for i, (_, turn) in one.moves.items() if i not in other.moves}
    turns |= {i: scale(turn, -1.0) for i, (_, turn) in other.moves.items() if i not in one.moves}
    turns = {i: turn for i, turn in sorted(turns.items()) if not all(is_zero(x) for x in turn)}
    return _Part(
        scale(imaginary, torque_scale),
        [dot(axis, turning) for axis in axes],
        add([dot(axis, changing) for axis in axes], bent),
        [{i: dot(axis, turn) for i, turn in turns.items()} for axis in axes],
    )


def _group(part: _Part, spring: SpringDamper, impedance: Number, inverse_weight: Number) -> RowGroup:
    reference = [
        reference_at(spring, impedance, distance, speed) - drift
        for distance, speed, drift in zip(part.violation, part.speed, part.drift, strict=True)
    ]
    return RowGroup(part.directions, reference, TwoSided(full_stiffness(impedance, inverse_weight)))


def _tie(fields: Fields, number: int) -> Tie:
    model = fields.model
    holds_axes = model.eq_type[number] == mujoco.mjtEq.mjEQ_WELD
    one, other = _attachments(model, number)
    of_both = [fields.row("body_invweight0", end.body) for end in (one, other)]
    translation, turn = (x + y for x, y in zip(*of_both, strict=True))
    return Tie(
        one=one,
        other=other,
        torque_scale=float(model.eq_data[number, 10]) if holds_axes else None,
        spring=read_spring(_floats(model.eq_solref[number]), model.eq_solimp[number], model.opt.timestep),
        inverse_weights=(translation, turn),
    )


def _attachments(model: mujoco.MjModel, number: int) -> Iterator[Attachment]:
    """Both, in MuJoCo's order."""
    ends, numbers = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])], model.eq_data[number]
    if model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE:
        for site in ends:
            body = int(model.site_bodyid[site])
            yield Attachment(body, _floats(model.site_pos[site]), _floats(model.site_quat[site]))
    elif model.eq_type[number] == mujoco.mjtEq.mjEQ_CONNECT:
        for body, place in zip(ends, (numbers[:3], numbers[3:6]), strict=True):
            yield Attachment(body, _floats(place), _UPRIGHT)
    else:
        yield Attachment(ends[0], _floats(numbers[3:6]), _floats(numbers[6:10]))
        yield Attachment(ends[1], _floats(numbers[:3]), _UPRIGHT)


def _floats(values: np.ndarray) -> Vector:
    return [float(value) for value in values]
