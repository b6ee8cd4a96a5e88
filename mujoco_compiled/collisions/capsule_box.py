"""Where a capsule touches a box: at the place of its axis that is nearest to the box, and at a second one.

The second is as far along the axis as it still lies above the box, if the axis leads along a face or an edge.
Which cases have a second point, and where, is MuJoCo's choice; there a place on the axis is a number from -1,
one end, to 1, the other.
Source: MuJoCo's `mjraw_CapsuleBox`.
"""

from dataclasses import dataclass
from functools import reduce
from itertools import product

from mujoco_compiled.collisions.boxes import ball_in_box
from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    absolute,
    add,
    clip,
    dot,
    maximum,
    minimum,
    scale,
    select,
    subtract,
    total,
)

_SMALLEST, _FAR = 1e-15, 1e15
# Marks 'no second contact'. An offset of 0 is valid: MuJoCo reports the point twice.
_NONE = -4.0


def capsule_box(capsule: Placed, box: Placed) -> list[Touch]:
    """Two points."""
    radius, segment = capsule.size[0], _segment(capsule, box)
    face, edge = _nearest_end(segment), _nearest_edge(segment)
    is_edge = edge.distance < face.distance - _SMALLEST
    first = select(is_edge, edge.place, face.place)
    second = select(is_edge, _second_of_edge(segment, edge), _second_of_face(segment, face))
    touches = [ball_in_box(segment.at(place), radius, box) for place in (first, first + second)]
    has_second = second > 0.75 * _NONE
    return [touches[0], _if(has_second, touches[1])]


def capsule_box_gap(capsule: Placed, box: Placed) -> Number:
    """How far apart both are at least: as the directions of the box's faces have it."""
    segment = _segment(capsule, box)
    sides = zip(segment.middle, segment.half, box.size, strict=True)
    return reduce(maximum, (absolute(x) - absolute(way) - size for x, way, size in sides)) - capsule.size[0]


def _if(exists: Number, touch: Touch) -> Touch:
    return Touch(touch.position, select(exists, touch.distance, AWAY), touch.normal)


@dataclass(frozen=True)
class _Segment:
    """The capsule's axis in the box's frame. middle: [3]; axis: [3], of length 1; size: half the box, [3]."""

    middle: Vector
    axis: Vector
    half_length: float
    size: Vector

    @property
    def half(self) -> Vector:
        return scale(self.axis, self.half_length)

    @property
    def crossings(self) -> Vector:
        """By axis: the length of way, in half lengths, from one face of the box to the opposite one."""
        return [
            2.0 * size / maximum(absolute(x), _SMALLEST) for size, x in zip(self.size, self.half, strict=True)
        ]

    @property
    def signs(self) -> Vector:
        return [select(x > 0.0, 1.0, -1.0) for x in self.half]

    def at(self, place: Number) -> Vector:
        return add(self.middle, scale(self.half, place))


def _segment(capsule: Placed, box: Placed) -> _Segment:
    middle = box.inward(subtract(capsule.position, box.position))
    return _Segment(middle, box.inward(capsule.axis), capsule.size[1], box.size)


@dataclass(frozen=True)
class _End:
    """An end above a face, or inside. distance: squared, to the box; outside: by axis, whether it is."""

    distance: Number
    place: Number
    outside: Vector


@dataclass(frozen=True)
class _Edge:
    """Where the axis is nearest to an edge. distance: squared. box_place: on the edge, from -1 to 1.

    corner: [3], -1 or 1; 0 along the edge, where it lies between two corners. MuJoCo says that of the point
    that is nearest to a line without ends, too.
    """

    distance: Number
    place: Number
    box_place: Number
    corner: Vector


def _nearest_end(segment: _Segment) -> _End:
    """The nearest of the ends that are outside the box in one direction at most."""
    ends = [_end(segment, place) for place in (-1.0, 1.0)]
    second = ends[1].distance < ends[0].distance
    outside = [select(second, x, y) for x, y in zip(ends[1].outside, ends[0].outside, strict=True)]
    distance = minimum(ends[0].distance, ends[1].distance)
    return _End(distance, select(second, 1.0, -1.0), outside)


def _end(segment: _Segment, place: float) -> _End:
    point = segment.at(place)
    over = [x - clip(x, -size, size) for x, size in zip(point, segment.size, strict=True)]
    outside = [select(absolute(x) > 0.0, 1.0, 0.0) for x in over]
    return _End(select(total(outside) > 1.5, _FAR, dot(over, over)), place, outside)


def _nearest_edge(segment: _Segment) -> _Edge:
    best: _Edge | None = None
    for along in range(3):
        for signs in product((-1.0, 1.0), repeat=2):
            corner = [*signs[:along], 0.0, *signs[along:]]
            edge = _edge(segment, along, corner)
            best = edge if best is None else _nearer(best, edge)
    assert best is not None  # noqa: S101
    return best


def _nearer(one: _Edge, other: _Edge) -> _Edge:
    is_other = other.distance < one.distance - _SMALLEST
    corner = [select(is_other, x, y) for x, y in zip(other.corner, one.corner, strict=True)]
    return _Edge(
        select(is_other, other.distance, one.distance),
        select(is_other, other.place, one.place),
        select(is_other, other.box_place, one.box_place),
        corner,
    )


def _edge(segment: _Segment, along: int, corner: Vector) -> _Edge:
    """The nearest points of the axis and of one edge. corner: the edge's middle, in sizes of the box."""
    size, half, length = segment.size[along], segment.half, segment.half_length
    middle = [x * whole for x, whole in zip(corner, segment.size, strict=True)]
    apart = subtract(middle, segment.middle)
    # Both places minimise a quadratic form; each is clipped while the other stays.
    own = dot(half, apart) * (1.0 / length**2)
    lead = size * half[along] * (1.0 / length**2)
    back = half[along] / size
    away = -apart[along] / size
    determinant = 1.0 - lead * back
    is_parallel = absolute(determinant) < _SMALLEST
    on_line = (away + back * own) / select(is_parallel, 1.0, determinant)
    place = clip(own + lead * clip(on_line, -1.0, 1.0), -1.0, 1.0)
    beside = away + back * place
    on_edge = clip(beside, -1.0, 1.0)
    way = subtract(apart, scale(half, place))
    way[along] = way[along] + size * on_edge
    point = list(corner)
    point[along] = _side(beside, _side(on_line, 0.0))
    return _Edge(select(is_parallel, _FAR, dot(way, way)), place, on_edge, point)


def _side(x: Number, between: Number) -> Number:
    """1 above 1, -1 below -1."""
    return select(x > 1.0, 1.0, select(x < -1.0, -1.0, between))


def _second_of_edge(segment: _Segment, edge: _Edge) -> Number:
    """The way to the second point from the nearest one, at an edge or a corner."""
    # 1 where the axis leads from the corner away from the box, in this direction; the box's corner has the
    # sign of the edge's middle, or of its end.
    differs = [select(sign * x < 0.0, 1.0, 0.0) for sign, x in zip(segment.signs, edge.corner, strict=True)]
    between = [absolute(x) < 0.5 for x in edge.corner]
    at_corner = _second_of_corner(segment, edge.place, differs)
    at_edges = [_second_along(segment, edge, along, differs) for along in range(3)]
    found = at_corner
    for is_between, second in zip(between, at_edges, strict=True):
        found = select(is_between, second, found)
    return found


def _second_of_corner(segment: _Segment, place: Number, differs: Vector) -> Number:
    count = total(differs)
    is_one = count < 1.5
    forward = select(is_one, 1.0, -1.0)
    # The axis in which the corner is unlike both others.
    odd = [select(is_one, x, 1.0 - x) > 0.5 for x in differs]
    crossings = segment.crossings
    ahead, behind = 1.0 - forward * place, 1.0 + forward * place
    along_edge, along_face = ahead, behind
    leads = 0.0
    for is_odd, crossing, axis in zip(odd, crossings, segment.axis, strict=True):
        along_edge = minimum(along_edge, select(is_odd, crossing, _FAR))
        along_face = minimum(along_face, select(is_odd, _FAR, crossing))
        leads = select(is_odd, axis * axis, leads)
    second = select(leads > 0.5, along_edge, -along_face) * forward
    return select(absolute(count - 1.5) < 1.0, second, _NONE)


def _second_along(segment: _Segment, edge: _Edge, along: int, differs: Vector) -> Number:
    """Where the nearest point is in the middle of an edge along this axis."""
    one, other = (along + 1) % 3, (along + 2) % 3
    crossings, signs = segment.crossings, segment.signs
    is_one = absolute(segment.axis[one]) > absolute(segment.axis[other])
    crossing = select(is_one, crossings[one], crossings[other])
    forward = 2.0 * select(is_one, differs[one], differs[other]) - 1.0
    to_end = 1.0 - signs[along] * forward * edge.box_place
    length = minimum(minimum(1.0 - forward * edge.place, crossing), 0.5 * crossings[along] * to_end)
    crosses = absolute(differs[one] - differs[other]) > 0.5
    return select(crosses, forward * length, _NONE)


def _second_of_face(segment: _Segment, end: _End) -> Number:
    """Where an end is above a face: how far the axis leads before it leaves the face."""
    forward = -end.place
    point = segment.at(end.place)
    length = 2.0
    for k, sign in enumerate(segment.signs):
        room = segment.size[k] - forward * sign * point[k]
        left = 0.5 * segment.crossings[k] * room / segment.size[k]
        length = minimum(length, select(end.outside[k] > 0.5, _FAR, left))
    return select(total(end.outside) > 0.5, forward * length, _NONE)
