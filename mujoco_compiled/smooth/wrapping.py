"""The shortest way of a string from one point to another round a sphere or a cylinder.

Source: MuJoCo's documentation, XML reference, "tendon/spatial/geom". What it leaves open (which of two ways
is taken, when there is none) was measured, and is tested.
"""

from dataclasses import dataclass
from math import pi

from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    clip,
    cross,
    dot,
    maximum,
    minimum,
    scale,
    select,
    sqrt,
    subtract,
)
from mujoco_compiled.program.flow import repeat
from mujoco_compiled.smooth.spatial import angle_of

_SMALLEST = 1e-30
# Of Newton's method, which doubles its digits in each.
_ITERATIONS = 8
# A way that crosses itself is worse than any other.
_WORST = -1e4
# A string that just touches wraps by an angle of 0, which rounding makes a whole turn less a little.
_ROUNDING = 1e-4


@dataclass(frozen=True)
class Obstacle:
    """A sphere or a cylinder along its z axis.

    body: that carries it. position [3] in m and rotation: in the body's frame. side: [3] in its own frame,
    where the string must pass; None: anywhere. is_ring: the string passes through it, not round it.
    """

    body: int
    position: Vector
    rotation: Matrix
    radius: Number
    is_cylinder: bool
    side: Vector | None
    is_ring: bool


@dataclass(frozen=True)
class Wrap:
    """touches: whether the string is not straight. first, last: [3], where it meets and leaves the obstacle.
    length: between them along the obstacle, in m. All in the obstacle's frame."""

    touches: Number
    first: Vector
    last: Vector
    length: Number


@dataclass(frozen=True)
class _Flat:
    """The same in a plane, with points [2]."""

    touches: Number
    first: Vector
    last: Vector
    length: Number


def wrap(obstacle: Obstacle, start: Vector, end: Vector) -> Wrap:
    """start, end: [3] in the obstacle's frame."""
    if obstacle.is_cylinder:
        return _round_cylinder(obstacle, start, end)
    # In the plane through the centre and both points.
    normal = cross(start, end)
    along = _unit(start)
    axes = [along, cross(_unit(normal), along)]
    side = None if obstacle.side is None else _in_plane(axes, obstacle.side)
    flat = _in_a_plane(obstacle, _in_plane(axes, start), _in_plane(axes, end), side)
    first, last = (add(scale(axes[0], x), scale(axes[1], y)) for x, y in (flat.first, flat.last))
    return Wrap(flat.touches, first, last, flat.length)


def _round_cylinder(obstacle: Obstacle, start: Vector, end: Vector) -> Wrap:
    """The height changes evenly along the way, which is straight on the unrolled cylinder."""
    side = None if obstacle.side is None else obstacle.side[:2]
    flat = _in_a_plane(obstacle, start[:2], end[:2], side)
    before, after = _length(subtract(flat.first, start[:2])), _length(subtract(end[:2], flat.last))
    slope = (end[2] - start[2]) / maximum(before + flat.length + after, _SMALLEST)
    first = [*flat.first, start[2] + slope * before]
    last = [*flat.last, end[2] - slope * after]
    rise = last[2] - first[2]
    return Wrap(flat.touches, first, last, sqrt(flat.length * flat.length + rise * rise))


def _in_a_plane(obstacle: Obstacle, start: Vector, end: Vector, side: Vector | None) -> _Flat:
    radius = obstacle.radius
    squares = dot(start, start), dot(end, end)
    are_outside = radius * radius < minimum(*squares)
    way = subtract(end, start)
    share = clip(-dot(start, way) / maximum(dot(way, way), _SMALLEST), 0.0, 1.0)
    nearest = add(start, scale(way, share))
    clearance = dot(nearest, nearest) - radius * radius
    if obstacle.is_ring:
        point = _mirrored(nearest, start, end, radius)
        return _Flat(are_outside & (clearance > 0.0), point, point, 0.0)
    tangents = [sqrt(maximum(square - radius * radius, _SMALLEST)) for square in squares]
    shares = [radius / maximum(square, _SMALLEST) for square in squares]

    def touching(turn: Number) -> tuple[Vector, Vector]:
        """Where the string meets and leaves the circle on which it turns left (1) or right (-1)."""
        first, last = (
            [share * (radius * x - sign * tangent * y), share * (radius * y + sign * tangent * x)]
            for (x, y), sign, tangent, share in zip(
                (start, end), (turn, -turn), tangents, shares, strict=True
            )
        )
        return first, last

    if side is None:
        # The shorter way.
        turn = select(_turn(start, end) < 0.0, -1.0, 1.0)
        touches = are_outside & (clearance < 0.0)
    else:
        left, right = (_score(start, end, touching(sign), side) for sign in (1.0, -1.0))
        turn = select(right < left, 1.0, -1.0)
        # Also where it passes the obstacle on the wrong side.
        is_needed = minimum(clearance, dot(nearest, side)) < 0.0
        touches = are_outside & is_needed & (maximum(left, right) > 0.5 * _WORST)
    first, last = touching(turn)
    square = maximum(radius * radius, _SMALLEST)
    angle = _turned(turn * _turn(first, last) / square, dot(first, last) / square, whole=side is not None)
    return _Flat(touches, first, last, radius * angle)


def _score(start: Vector, end: Vector, touching: tuple[Vector, Vector], side: Vector) -> Number:
    """How well a way goes by the side: the cosine between the side and the middle of both points."""
    first, last = touching
    score = dot(_unit(add(first, last)), _unit(side))
    return select(_cross(subtract(first, start), subtract(last, end), subtract(end, start)), _WORST, score)


def _cross(one: Vector, other: Vector, apart: Vector) -> Number:
    """Whether two line segments meet, of which the other begins `apart` from the first."""
    whole = _turn(one, other)
    sign = select(whole < 0.0, -1.0, 1.0)
    along, across = sign * _turn(apart, other), sign * _turn(apart, one)
    least, most = minimum(along, across), maximum(along, across)
    return minimum(least, sign * whole - most) > 0.0


def _mirrored(begun: Vector, start: Vector, end: Vector, radius: Number) -> Vector:
    """The point of the circle on the shortest way from start to end by it, as of a ray that it mirrors.

    begun: near its direction. Newton's method turns that direction; MuJoCo's own stops at an error of 1e-6.
    """

    def turned(towards: list[Number]) -> tuple[list[Number], Number]:
        ahead = [-towards[1], towards[0]]
        slope, curvature = 0.0, _SMALLEST
        for point in (start, end):
            way = subtract(point, scale(towards, radius))
            distance = maximum(_length(way), _SMALLEST)
            onward, outward = dot(way, ahead) / distance, dot(way, towards) / distance
            slope = slope - onward
            curvature = curvature + (outward + radius * (1.0 - onward * onward) / distance)
        return _unit(subtract(towards, scale(ahead, slope / curvature))), True

    return scale(repeat(_ITERATIONS, turned, _unit(begun)), radius)


def _turned(sine: Number, cosine: Number, *, whole: bool) -> Number:
    """The angle in rad with this sine and cosine: up to a whole turn, or up to half of one."""
    if not whole:
        sine = maximum(sine, 0.0)
    acute = angle_of(absolute(sine), absolute(cosine))
    obtuse = select(cosine < 0.0, pi - acute, acute)
    return select(sine < -_ROUNDING, 2.0 * pi - obtuse, obtuse) if whole else obtuse


def _in_plane(axes: Matrix, point: Vector) -> Vector:
    return [dot(axis, point) for axis in axes]


def _turn(one: Vector, other: Vector) -> Number:
    """Above 0 where the other is to the left of the first."""
    return one[0] * other[1] - one[1] * other[0]


def _length(vector: Vector) -> Number:
    return sqrt(maximum(dot(vector, vector), _SMALLEST))


def _unit(vector: Vector) -> Vector:
    return scale(vector, 1.0 / _length(vector))
