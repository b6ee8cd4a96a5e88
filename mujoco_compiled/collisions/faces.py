"""Where a geom lies on a flat face of another one: at several points, as on a plane, within the face.

One point does not carry what stands. So where a contact's normal is that of a box's face or of a cylinder's
end, the other geom touches that face's plane where it would touch a plane. What is beyond the face is drawn
along the line to the one point that lies deepest, up to the face's edge.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce

from mujoco_compiled.collisions.convex import convex_touch
from mujoco_compiled.collisions.planes import plane_box, plane_capsule, plane_cylinder, plane_mesh
from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch, chosen
from mujoco_compiled.collisions.supports import BOX, CAPSULE, CYLINDER, MESH, Convex, convex_geom
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    absolute,
    add,
    clip,
    dot,
    maximum,
    minimum,
    rotate,
    scale,
    select,
    sqrt,
    subtract,
    total,
    transpose,
)

# The cosine of 1.4e-3 rad, some times the normal's error: below it, another feature than the face touches.
_ALIGNED = 1.0 - 1e-6
_SMALLEST = 1e-15
# What lies on a face, and at how many points.
_ON_PLANES: Mapping[int, tuple[Callable[[Placed, Placed], list[Touch]], int]] = {
    CAPSULE: (plane_capsule, 2),
    CYLINDER: (plane_cylinder, 4),
    BOX: (plane_box, 4),
    MESH: (plane_mesh, 4),
}
_HAVE_FACES = (CYLINDER, BOX)


def num_convex_points(kind: int, other: int) -> int:
    """The most points of two kinds of geoms."""
    return max([1, *(_ON_PLANES[lying][1] for _, lying in _faces(kind, other))])


def convex_collider(kind: int, other: int) -> Callable[[Placed, Placed], list[Touch]]:
    """What computes the points of two kinds of convex geoms; those that are not there are far apart."""

    def collide(one_geom: Placed, other_geom: Placed) -> list[Touch]:
        both = convex_geom(kind, one_geom), convex_geom(other, other_geom)
        touch = convex_touch(*both)
        away = Touch(touch.position, AWAY, touch.normal)
        points = [touch] + [away] * (num_convex_points(kind, other) - 1)
        share: Number = 0.0
        for place, _ in _faces(kind, other):
            found = _on_face(both[place], both[1 - place], touch, 1.0 - 2.0 * place)
            is_better = found.is_aligned & (share < found.share)
            share = select(is_better, found.share, share)
            lying = [*found.points, *([away] * (len(points) - len(found.points)))]
            points = [chosen(is_better, *pair) for pair in zip(lying, points, strict=True)]
        return points

    return collide


def _faces(kind: int, other: int) -> list[tuple[int, int]]:
    """The places (0, 1) of geoms that have faces, each with the kind that can lie on them."""
    pairs = [(0, kind, other), (1, other, kind)]
    return [(place, lying) for place, own, lying in pairs if own in _HAVE_FACES and lying in _ON_PLANES]


@dataclass(frozen=True)
class _Face:
    """is_aligned: whether the contact's normal is its own. plane: its z axis is outwards. within: the part of
    a way [3] from a point [3] of the face that is inside."""

    is_aligned: Number
    plane: Placed
    within: Callable[[Vector, Vector], Number]


@dataclass(frozen=True)
class _Lying:
    """Points where a geom lies on a face. share: how little of it is beyond the face. Where two faces lie on
    each other, the smaller one's corners count."""

    is_aligned: Number
    share: Number
    points: list[Touch]


def _on_face(lower: Convex, upper: Convex, touch: Touch, sign: float) -> _Lying:
    """sign: 1 if the lower geom, whose face it is, is the contact's first; otherwise -1."""
    face = (_box_face if lower.kind == BOX else _cylinder_end)(lower, scale(touch.normal, sign))
    normal = scale(face.plane.axis, sign)
    points, parts = list[Touch](), list[Number]()
    for point in _ON_PLANES[upper.kind][0](face.plane, upper.geom):
        way = subtract(point.position, touch.position)
        parts.append(face.within(touch.position, way))
        position = add(touch.position, scale(way, parts[-1]))
        distance = touch.distance + parts[-1] * (point.distance - touch.distance)
        points.append(Touch(position, distance, normal))
    return _Lying(face.is_aligned, total(parts) / len(parts), points)


def _box_face(box: Convex, outwards: Vector) -> _Face:
    """The face whose normal is nearest to a direction [3]."""
    to_world, size = box.to_world, box.geom.size
    local = rotate(transpose(to_world), outwards)
    largest = reduce(maximum, [absolute(x) for x in local])
    normal = [select(absolute(x) < largest, 0.0, select(x < 0.0, -1.0, 1.0)) for x in local]
    axis = rotate(to_world, normal)
    reach = total(absolute(x) * length for x, length in zip(normal, size, strict=True))

    def within(point: Vector, way: Vector) -> Number:
        place = rotate(transpose(to_world), subtract(point, box.geom.position))
        ahead = rotate(transpose(to_world), way)
        # Across the face alone: the contact's points are a little above or below it.
        parts = [
            select(absolute(x) > 0.5, 1.0, _part(length, at, step))
            for x, length, at, step in zip(normal, size, place, ahead, strict=True)
        ]
        return reduce(minimum, parts)

    return _Face(largest > _ALIGNED, _plane(add(box.geom.position, scale(axis, reach)), axis), within)


def _part(half: Number, place: Number, step: Number) -> Number:
    """How much of a step leads from a place to the end at -half or half."""
    room = select(step < 0.0, half + place, half - place)
    return clip(room / maximum(absolute(step), _SMALLEST), 0.0, 1.0)


def _cylinder_end(cylinder: Convex, outwards: Vector) -> _Face:
    """The end that looks in a direction [3]."""
    axis = transpose(cylinder.to_world)[2]
    radius, half, _ = cylinder.geom.size
    cosine = dot(axis, outwards)
    outside = [select(cosine < 0.0, -x, x) for x in axis]

    def within(point: Vector, way: Vector) -> Number:
        place = subtract(point, cylinder.geom.position)
        place, ahead = (subtract(x, scale(axis, dot(axis, x))) for x in (place, way))
        # Where |place + part · ahead| is the radius.
        square, slope = maximum(dot(ahead, ahead), _SMALLEST), dot(place, ahead)
        room = maximum(radius * radius - dot(place, place), 0.0)
        return clip((sqrt(slope * slope + square * room) - slope) / square, 0.0, 1.0)

    middle = add(cylinder.geom.position, scale(outside, half))
    return _Face(absolute(cosine) > _ALIGNED, _plane(middle, outside), within)


def _plane(position: Vector, axis: Vector) -> Placed:
    """A plane whose z axis is given; it has no others."""
    rotation = [[0.0, 0.0, x] for x in axis]
    return Placed(position, rotation, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0])
