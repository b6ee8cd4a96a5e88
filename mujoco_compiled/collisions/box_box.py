"""Where two boxes touch: at up to eight corners of a polygon on a face, or at one point between two edges.

There are 15 directions to look along: of six faces, and at right angles to an edge of each box. The boxes
overlap least in one of them. If it is a face's, the other box's face that looks towards it is clipped to it,
and each corner of what is left is a point.
Source: MuJoCo's `mjc_BoxBox`, with its constants for single precision.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product

from mujoco_compiled.collisions.rectangles import Rectangle, overlap
from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    clip,
    dot,
    maximum,
    rotate,
    scale,
    select,
    sqrt,
    subtract,
    total,
    transpose,
)

# sin² of an angle between edges. Below it they count as parallel, and the directions of faces suffice.
_PARALLEL = 1e-7
# Where a component of a direction is smaller, rounding may choose the wrong one of two edges: both are tried.
_UNDECIDED = 1e-5
# Edges must be better than a face by a part of the overlap, as several points carry better than one: by the
# first part in any direction, by the second where the cosine of the angle to the face's direction is larger.
_EDGE_BIAS, _FACE_BIAS, _NEAR_FACE = 1e-6, 0.05, 0.99
_SMALLEST = 1e-15


def box_box(one: Placed, other: Placed) -> list[Touch]:
    """Eight points; those that are not there are far apart."""
    boxes = _boxes(one, other)
    face = _best_face(boxes)
    edges = _best_edges(boxes, face.gap)
    is_edge = edges.are_better & ~_is_near_face(edges, face, boxes)
    first, *others = _touches_of_face(face, boxes)
    point = _touch_of_edges(edges, boxes)
    return [
        Touch(
            _chosen(is_edge, point.position, first.position),
            select(is_edge, point.distance, first.distance),
            _chosen(is_edge, point.normal, first.normal),
        ),
        *(Touch(one.position, select(is_edge, AWAY, one.distance), one.normal) for one in others),
    ]


def box_box_gap(one: Placed, other: Placed) -> Number:
    """How far apart the boxes are at least: as the faces' directions have it."""
    return _best_face(_boxes(one, other)).gap


@dataclass(frozen=True)
class _Boxes:
    """positions, sizes: of both, [2][3]. axes: in the world, [2][3][3]. way: from the first to the second.

    ways: along each box's axes, [2][3]. turns: [3][3], the second's axes (columns) along the first's (rows).
    """

    positions: Matrix
    sizes: Matrix
    axes: list[Matrix]
    ways: Matrix
    turns: Matrix


def _boxes(one: Placed, other: Placed) -> _Boxes:
    axes = [[box.outward(_unit(k)) for k in range(3)] for box in (one, other)]
    way = subtract(other.position, one.position)
    return _Boxes(
        positions=[one.position, other.position],
        sizes=[one.size, other.size],
        axes=axes,
        ways=[rotate(own, way) for own in axes],
        turns=[[dot(a, b) for b in axes[1]] for a in axes[0]],
    )


@dataclass(frozen=True)
class _Face:
    """The direction of a face. gap: of the boxes along it, in m, below 0 where they overlap.

    is_second: whether it is the second box's. is_x, is_z: its axis; y otherwise.
    """

    gap: Number
    is_second: Number
    is_x: Number
    is_z: Number


def _best_face(boxes: _Boxes) -> _Face:
    extents = [[absolute(x) for x in row] for row in boxes.turns]
    gaps = [
        [
            absolute(way) - own - dot(row, others)
            for way, own, row in zip(ways, sizes, turns, strict=True)
        ]
        for ways, sizes, others, turns in zip(
            boxes.ways, boxes.sizes, reversed(boxes.sizes), (extents, transpose(extents)), strict=True
        )
    ]  # fmt: skip
    largest = [reduce(maximum, own) for own in gaps]
    is_second = largest[0] < largest[1]
    is_x, is_z = _largest(_chosen(is_second, gaps[1], gaps[0]))
    return _Face(maximum(*largest), is_second, is_x, is_z)


@dataclass(frozen=True)
class _Edges:
    """An edge of each box. gap: see `_Face`. axis: its direction, [3] in the first box's frame.

    along: for each box, [3]: 1 for the axis of its edge, otherwise 0; 0 for all where a face is better.
    sine_squared: of the angle between both.
    """

    gap: Number
    axis: Vector
    along: Matrix
    sine_squared: Number

    @property
    def are_better(self) -> Number:
        """Than each face."""
        return total(self.along[0]) > 0.5


def _best_edges(boxes: _Boxes, face_gap: Number) -> _Edges:
    best = _Edges(face_gap, [0.0, 0.0, 1.0], [[0.0] * 3, [0.0] * 3], 1.0)
    for i, k in product(range(3), repeat=2):
        edges = _edges(boxes, i, k)
        is_better = (best.gap < edges.gap - _EDGE_BIAS * absolute(edges.gap)) & (face_gap < edges.gap)
        best = _Edges(
            select(is_better, edges.gap, best.gap),
            _chosen(is_better, edges.axis, best.axis),
            [_chosen(is_better, new, old) for new, old in zip(edges.along, best.along, strict=True)],
            select(is_better, edges.sine_squared, best.sine_squared),
        )
    return best


def _edges(boxes: _Boxes, i: int, k: int) -> _Edges:
    """Those along axis i of the first box, and axis k of the second."""
    after, last = (i + 1) % 3, (i + 2) % 3
    axis: Vector = [0.0, 0.0, 0.0]
    axis[after], axis[last] = -boxes.turns[last][k], boxes.turns[after][k]
    sine_squared = dot(axis, axis)
    axis = scale(axis, 1.0 / sqrt(maximum(sine_squared, _PARALLEL)))
    in_second = rotate(transpose(boxes.turns), axis)
    in_second[k] = 0.0
    reaches = (
        dot(size, [absolute(x) for x in one])
        for size, one in zip(boxes.sizes, (axis, in_second), strict=True)
    )
    gap = absolute(dot(axis, boxes.ways[0])) - total(reaches)
    gap = select(sine_squared < _PARALLEL, -AWAY, gap)
    return _Edges(gap, axis, [_unit(i), _unit(k)], sine_squared)


def _is_near_face(edges: _Edges, face: _Face, boxes: _Boxes) -> Number:
    """Whether the edges have nearly the direction of the face, and hardly less overlap."""
    others = rotate(transpose(boxes.turns), edges.axis)
    part = _of_axis(face.is_x, face.is_z, _chosen(face.is_second, others, edges.axis))[2]
    most = face.gap + _FACE_BIAS * absolute(face.gap) + _SMALLEST
    return (absolute(part) > _NEAR_FACE) & (edges.gap < most)


def _touch_of_edges(edges: _Edges, boxes: _Boxes) -> Touch:
    """Midway between the nearest points of both edges."""
    axis = _signed(dot(edges.axis, boxes.ways[0]), edges.axis)
    along, across = edges.along[0], rotate(boxes.turns, edges.along[1])
    halves = [dot(own, size) for own, size in zip(edges.along, boxes.sizes, strict=True)]
    firsts = _middles(axis, edges.along[0], boxes.sizes[0])
    directions = scale(rotate(transpose(boxes.turns), axis), -1.0)
    seconds = [
        add(boxes.ways[0], rotate(boxes.turns, middle))
        for middle in _middles(directions, edges.along[1], boxes.sizes[1])
    ]
    best: tuple[Number, Vector, Vector] | None = None
    for first, second in product(firsts, seconds):
        apart = subtract(second, first)
        own, others, cosine = dot(along, apart), dot(across, apart), dot(along, across)
        # Where lines without ends are nearest; then each place is clipped while the other stays.
        place = clip((own - cosine * others) / edges.sine_squared, -halves[0], halves[0])
        place_other = clip(cosine * place - others, -halves[1], halves[1])
        place = clip(own + cosine * place_other, -halves[0], halves[0])
        points = add(first, scale(along, place)), add(second, scale(across, place_other))
        way = subtract(points[1], points[0])
        found = dot(way, way), scale(add(*points), 0.5), way
        best = found if best is None else _nearer(best, found)
    assert best is not None  # noqa: S101
    _, middle, way = best
    to_world = transpose(boxes.axes[0])
    position = add(boxes.positions[0], rotate(to_world, middle))
    return Touch(position, dot(way, axis), rotate(to_world, axis))


def _middles(direction: Vector, along: Vector, size: Vector) -> list[Vector]:
    """The middle of the edge that is farthest in a direction; two where the direction leaves two edges."""
    is_along = [x > 0.5 for x in along]
    corner = [select(x < 0.0, -own, own) for x, own in zip(direction, size, strict=True)]
    middle = [select(one, 0.0, x) for one, x in zip(is_along, corner, strict=True)]
    other = [select(absolute(x) < _UNDECIDED, -own, own) for x, own in zip(direction, middle, strict=True)]
    return [middle, other]


def _nearer(
    one: tuple[Number, Vector, Vector], other: tuple[Number, Vector, Vector]
) -> tuple[Number, Vector, Vector]:
    is_other = other[0] < one[0]
    return (
        select(is_other, other[0], one[0]),
        _chosen(is_other, other[1], one[1]),
        _chosen(is_other, other[2], one[2]),
    )


def _touches_of_face(face: _Face, boxes: _Boxes) -> list[Touch]:
    """The corners of the polygon that is left of the other box's face."""
    is_second = face.is_second

    def turned(vector: Vector) -> Vector:
        """In an order of the axes in which the face's own is the last."""
        return _of_axis(face.is_x, face.is_z, vector)

    size = turned(_chosen(is_second, boxes.sizes[1], boxes.sizes[0]))
    way = turned(_chosen(is_second, scale(boxes.ways[1], -1.0), boxes.ways[0]))
    axes = [
        turned(_chosen(is_second, *both)) for both in zip(boxes.turns, transpose(boxes.turns), strict=True)
    ]
    to_world = [
        turned(_chosen(is_second, *both))
        for both in zip(transpose(boxes.axes[1]), transpose(boxes.axes[0]), strict=True)
    ]
    # Upwards is towards the other box.
    is_below = way[2] < 0.0
    for vector in (*axes, *to_world):
        vector[2] = select(is_below, -vector[2], vector[2])
    middle = [*way[:2], absolute(way[2]) - size[2]]
    polygon = overlap(size[:2], _facing(middle, axes, _chosen(is_second, *boxes.sizes)))
    centre = _chosen(is_second, boxes.positions[1], boxes.positions[0])
    normal = [select(is_second, -row[2], row[2]) for row in to_world]
    return [
        Touch(add(centre, rotate(to_world, [x, y, size[2] + 0.5 * z])), select(exists, z, AWAY), normal)
        for exists, (x, y, z) in polygon
    ]


def _facing(middle: Vector, axes: Matrix, size: Vector) -> Rectangle:
    """The lowest of a box's faces. middle: of the box, [3]; axes: the box's, [3][3]; size: half, [3]."""
    is_x, is_z = _largest([absolute(axis[2]) for axis in axes])
    lengths = _of_axis(is_x, is_z, size)
    one, other, own = transpose([_of_axis(is_x, is_z, list(row)) for row in zip(*axes, strict=True)])
    downwards = _signed(-own[2], own)
    centre = add(middle, scale(downwards, lengths[2]))
    return Rectangle(centre, [scale(one, lengths[0]), scale(other, lengths[1])], lengths[:2])


def _largest(values: Vector) -> tuple[Number, Number]:
    """Whether the first and the last of three is the largest; of equal ones, the earlier."""
    x, y, z = values
    return ~(x < y) & ~(x < z), (x < z) & (y < z)


def _of_axis(is_x: Number, is_z: Number, values: Vector) -> Vector:
    """The three values of axes, with those of the other two axes first, in the order x, y, z, x."""
    return [select(is_x, values[(k + 1) % 3], select(is_z, values[k], values[(k + 2) % 3])) for k in range(3)]


def _signed(sign: Number, vector: Vector) -> Vector:
    """The opposite vector where a number is below 0."""
    return [select(sign < 0.0, -x, x) for x in vector]


def _chosen(condition: Number, ones: Sequence[Number], others: Sequence[Number]) -> Vector:
    return [select(condition, one, other) for one, other in zip(ones, others, strict=True)]


def _unit(axis: int) -> Vector:
    return [1.0 if k == axis else 0.0 for k in range(3)]
