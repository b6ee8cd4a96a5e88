"""Where a cylinder touches a box: as MuJoCo has it, at up to four points of one of the box's faces.

The direction of least overlap says which of the box's faces can be meant: one, the two at an edge, or the
three at a corner. If the cylinder's end is almost parallel to one of them, both overlap in a polygon, of
which four corners count. Otherwise, if the cylinder's side is, the line along it counts as far as it is above
the face. Otherwise there is one point. Almost means 5.1 degrees, and an end is a polygon of 16 corners.

Source: MuJoCo's documentation, Computation, "Collision detection"; what MuJoCo 3.17 answers.
"""

from dataclasses import dataclass
from functools import reduce
from math import cos, pi, sin

from mujoco_compiled.collisions.convex import convex_touch
from mujoco_compiled.collisions.rectangles import CORNERS, starts
from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch, chosen
from mujoco_compiled.collisions.supports import BOX, CYLINDER, convex_geom, unit_or
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    dot,
    maximum,
    minimum,
    rotate,
    scale,
    select,
    subtract,
    total,
    transpose,
)
from mujoco_compiled.program.flow import where_needed

# In rad. Faces and sides that are less than this from parallel touch as if they were.
_PARALLEL = 0.0889
# A part of a direction of least overlap that is less is an error of the search for it.
_NO_PART = 1.4e-3
_NUM_CORNERS = 16
_SMALLEST, _LOWEST = 1e-15, -1e9
_ANGLES = [2.0 * pi * k / _NUM_CORNERS for k in range(_NUM_CORNERS)]


def cylinder_box(cylinder: Placed, box: Placed) -> list[Touch]:
    """Four points, of which those that are not there are far apart."""
    both = convex_geom(CYLINDER, cylinder), convex_geom(BOX, box)
    touch, to_box = convex_touch(*both), transpose(both[1].to_world)
    ahead, axes = rotate(to_box, touch.normal), [rotate(to_box, one) for one in transpose(both[0].to_world)]
    face, centre = _face(ahead, axes[2]), rotate(to_box, subtract(cylinder.position, box.position))
    size = face.picked(box.size)
    middle = [0.0, 0.0, size[2]]
    place = _OnFace(
        half=size[:2],
        centre=subtract(face.seen(centre), middle),
        axes=[face.seen(one) for one in axes],
        size=cylinder.size[:2],
        ahead=face.seen(ahead),
        highest=maximum(1.01 * touch.distance, 0.0) + _SMALLEST,
    )

    def to_world(vector: Vector) -> Vector:
        return rotate(both[1].to_world, face.unseen(vector))

    found, normal = [touch, *[Touch(touch.position, AWAY, touch.normal)] * 3], to_world([0.0, 0.0, -1.0])
    for lies, points in (
        (face.end_lies, _of_end_where(place, face.end_lies)),
        (face.side_lies, _of_side(place)),
    ):
        lowest = reduce(minimum, [one.distance for one in points])
        is_chosen = lies * _truth(lowest < place.highest) > 0.5
        placed = [
            Touch(add(box.position, to_world(add(one.position, middle))), one.distance, normal)
            for one in points
        ]
        found = [chosen(is_chosen, *pair) for pair in zip(placed, found, strict=True)]
    return found


@dataclass(frozen=True)
class _Face:
    """A box's face, by the number of its axis and whether the box is ahead in that axis' direction.

    is_first, is_second: 1.0 if the number is 0 or 1. sign: 1.0 or -1.0. end_lies, side_lies: 1.0 if the
    cylinder's end is almost parallel to it, or its side is.
    """

    is_first: Number
    is_second: Number
    sign: Number
    end_lies: Number
    side_lies: Number

    def picked(self, vector: Vector) -> Vector:
        """A vector [3] of the box's frame, turned round so that the face's axis is the last."""
        return self._turned(vector, 1)

    def seen(self, vector: Vector) -> Vector:
        """A vector [3] of the box's frame, with the last axis out of the face."""
        x, y, z = self.picked(vector)
        return [x, y, -self.sign * z]

    def unseen(self, vector: Vector) -> Vector:
        """What was seen so, [3], in the box's frame."""
        x, y, z = vector
        return self._turned([x, y, -self.sign * z], 2)

    def _turned(self, vector: Vector, places: int) -> Vector:
        """By so many places where the face's axis is the first, by the rest of three if it is the second."""
        once, twice = vector[places:] + vector[:places], vector[3 - places :] + vector[: 3 - places]
        return [
            select(self.is_first > 0.5, x, select(self.is_second > 0.5, y, z))
            for x, y, z in zip(once, twice, vector, strict=True)
        ]


@dataclass(frozen=True)
class _OnFace:
    """A cylinder above a box's face, whose centre is the origin and whose last axis is outwards.

    half: of the face, [2] in m. centre: the cylinder's. axes: its own, [3][3], the last one along it. size:
    its radius and half its length. ahead: from the cylinder to the box, the direction of least overlap.
    highest: a point that is farther away, in m, does not count: beyond the nearest, if none overlaps.
    """

    half: Vector
    centre: Vector
    axes: Matrix
    size: Vector
    ahead: Vector
    highest: Number


@dataclass(frozen=True)
class _Point:
    """position: [3], above the face. distance: in m."""

    position: Vector
    distance: Number


_NOWHERE: Vector = [0.0, 0.0, 0.0]


def _truth(condition: Number) -> Number:
    """A number, as conditions of constants are not negated as others are."""
    return select(condition, 1.0, 0.0)


def _face(ahead: Vector, axis: Vector) -> _Face:
    """The face that counts: the first to which the side is parallel, unless the end is to one."""
    along = _truth(sin(_PARALLEL) < absolute(dot(ahead, axis)))
    ends = [
        along * _truth(cos(_PARALLEL) < absolute(x)) * _truth(sin(_PARALLEL) < absolute(y))
        for x, y in zip(axis, ahead, strict=True)
    ]
    sides, left = list[Number](), 1.0 - total(ends)
    for x, y in zip(axis, ahead, strict=True):
        sides.append(left * _truth(absolute(x) < sin(_PARALLEL)) * _truth(absolute(y) > _NO_PART))
        left = left - sides[-1]
    faces = add(ends, sides)
    part = dot(faces, ahead)
    return _Face(faces[0], faces[1], select(part < 0.0, -1.0, 1.0), total(ends), total(sides))


def _of_side(place: _OnFace) -> list[_Point]:
    """The ends of the line along the cylinder that lies deepest, as far as it is above the face; and two
    points that are not there."""
    axis, (radius, half, *_) = place.axes[2], place.size
    across = subtract(place.ahead, scale(axis, dot(axis, place.ahead)))
    middle, way = add(place.centre, scale(unit_or(across, place.axes[0]), radius)), scale(axis, half)
    low: Number = -1.0
    high: Number = 1.0
    for at, step, reach in zip(middle, way, place.half, strict=False):
        inverse = 1.0 / select(absolute(step) < _SMALLEST, _SMALLEST, step)
        one, other = (-reach - at) * inverse, (reach - at) * inverse
        low, high = maximum(low, minimum(one, other)), minimum(high, maximum(one, other))
    points = [add(middle, scale(way, part)) for part in (low, high)]
    does_count = [_truth(point[2] < place.highest) for point in points]
    was_cut = [_truth(low > -1.0), _truth(high < 1.0)]
    found = list[_Point]()
    for own, other in ((0, 1), (1, 0)):
        # Where one end is too high, the other counts twice if an edge of the face cuts it off.
        is_other = (1.0 - does_count[own]) * does_count[other] * was_cut[other] > 0.5
        x, y, z = (select(is_other, *pair) for pair in zip(points[other], points[own], strict=True))
        found.append(_Point([x, y, 0.5 * z], select(high < low, AWAY, z)))
    return [*found, *[_Point(_NOWHERE, AWAY)] * 2]


def _of_end_where(place: _OnFace, lies: Number) -> list[_Point]:
    """Those of `_of_end` where the end is almost parallel to the face; elsewhere four that are not there."""

    def compute() -> Vector:
        return [x for one in _of_end(place) for x in (*one.position, one.distance)]

    found = where_needed(lies > 0.5, compute, lambda _: [*_NOWHERE, AWAY] * 4)
    return [_Point(found[first : first + 3], found[first + 3]) for first in range(0, 16, 4)]


def _of_end(place: _OnFace) -> list[_Point]:
    """Four corners of the polygon in which the end and the face overlap: those that lie farthest out in four
    directions between the face's axes."""
    end = _End.of(place)
    corners = [[x * place.half[0], y * place.half[1], 0.0] for x, y in CORNERS]
    outsides = [end.outside(corner) for corner in corners]
    candidates = starts(corners, outsides, True) + starts(corners, outsides, False)
    for angle in _ANGLES:
        point = end.below(angle)
        is_inside = [_truth(absolute(x) < reach) for x, reach in zip(point, place.half, strict=False)]
        candidates.append((is_inside[0] * is_inside[1] > 0.5, point))
    extent = [minimum(x, place.size[0]) for x in place.half]
    heights = [end.height(point) for _, point in candidates]
    found = list[_Point]()
    for signs in CORNERS:
        best: Vector = [_LOWEST, 0.0, 0.0, AWAY]
        for (exists, point), height in zip(candidates, heights, strict=True):
            reach = total(sign * x / half for sign, x, half in zip(signs, point, extent, strict=False))
            is_low = _truth(height < place.highest)
            counts = _truth(exists) * is_low * _truth(best[0] < reach) > 0.5
            own = [reach, *point[:2], height]
            best = [select(counts, x, y) for x, y in zip(own, best, strict=True)]
        found.append(end.point(*best[1:]))
    return _different(found)


def _different(points: list[_Point]) -> list[_Point]:
    """Those that are at an earlier one's place are not there."""
    found = list[_Point]()
    for point in points:
        distance = point.distance
        for earlier in found:
            way = subtract(point.position, earlier.position)
            distance = select(dot(way, way) < _SMALLEST, AWAY, distance)
        found.append(_Point(point.position, distance))
    return found


@dataclass(frozen=True)
class _End:
    """A cylinder's end above a face. middle: [3]. outwards: [3], its normal. axes: [2][3], of its polygon."""

    middle: Vector
    outwards: Vector
    axes: Matrix
    radius: Number

    @classmethod
    def of(cls, place: _OnFace) -> "_End":
        *axes, axis = place.axes
        outwards = [select(axis[2] < 0.0, x, -x) for x in axis]
        return cls(add(place.centre, scale(outwards, place.size[1])), outwards, axes, place.size[0])

    def below(self, angle: float) -> Vector:
        """The point of the face [3] that a corner of the polygon is moved to along the normal."""
        corner = add(scale(self.axes[0], cos(angle)), scale(self.axes[1], sin(angle)))
        corner = add(self.middle, scale(corner, self.radius))
        # An end that is not almost parallel does not count.
        x, y, _ = add(corner, scale(self.outwards, -corner[2] / minimum(self.outwards[2], -0.5)))
        return [x, y, 0.0]

    def outside(self, point: Vector) -> Vector:
        """How far a point [3] is beyond each of the polygon's edges, in m."""
        way = subtract(point, self.middle)
        x, y = (dot(axis, way) for axis in self.axes)
        middles = [angle + pi / _NUM_CORNERS for angle in _ANGLES]
        return [cos(one) * x + sin(one) * y - self.radius * cos(pi / _NUM_CORNERS) for one in middles]

    def height(self, point: Vector) -> Number:
        """How far a point [3] of the face is beyond the end, in m: below 0 where they overlap."""
        return dot(subtract(point, self.middle), self.outwards)

    def point(self, x: Number, y: Number, height: Number) -> _Point:
        """Midway between the end and what is below it."""
        distance = -height * self.outwards[2]
        on_end = subtract([x, y, 0.0], scale(self.outwards, height))
        return _Point(subtract(on_end, [0.0, 0.0, 0.5 * distance]), distance)
