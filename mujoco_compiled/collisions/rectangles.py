"""The polygon that two rectangles have in common, seen from above one of them.

Each edge of the polygon is a part of one of the rectangles' eight edges, and starts at one of its corners. So
those eight edges, clipped, give each corner once, wherever it is.
"""

from dataclasses import dataclass

from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    dot,
    maximum,
    minimum,
    scale,
    select,
    squared,
    subtract,
    total,
)

# As parts of the smaller rectangle's size. Points that are nearer to each other than the first are one point:
# MuJoCo's constant for single precision. Ends of edges that are nearer to a line than the second lie on it:
# otherwise rounding could lose an edge that two rectangles have in common.
_SAME_POINT, _ON_LINE = 1e-5, 1e-6
# In the order in which edges join them.
CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))
_SMALLEST = 1e-15


@dataclass(frozen=True)
class Rectangle:
    """A face in the frame of another one: its origin is that face's centre, and x and y lie along its edges.

    centre: [3]. edges: [2][3], half of each; lengths: theirs, [2].
    """

    centre: Vector
    edges: Matrix
    lengths: Vector

    def at(self, u: Number, v: Number) -> Vector:
        return add(self.centre, add(scale(self.edges[0], u), scale(self.edges[1], v)))


def overlap(size: Vector, face: Rectangle) -> list[tuple[Number, Vector]]:
    """A face clipped to a rectangle: whether each corner of what is left exists, and where it is, [3].

    size: half of the rectangle, [2].
    """
    smaller = minimum(total(size), total(face.lengths))
    corners = [face.at(u, v) for u, v in CORNERS]
    found = starts(corners, [_outside(corner, size, smaller) for corner in corners], True)
    (a, b, _), (c, d, _) = face.edges
    determinant = a * d - b * c
    corners, outsides = list[Vector](), list[Vector]()
    for corner in CORNERS:
        x, y = (own * half for own, half in zip(corner, size, strict=True))
        left, up = x - face.centre[0], y - face.centre[1]
        u, v = (left * d - up * c) / determinant, (a * up - b * left) / determinant
        corners.append([x, y, face.at(u, v)[2]])
        outsides.append(_outside([u * face.lengths[0], v * face.lengths[1]], face.lengths, smaller))
    # Seen from above, the face's edges may run the other way round.
    found += starts(corners, outsides, determinant > 0.0)
    return _different(found, squared(_SAME_POINT * smaller))


def _outside(point: Vector, size: Vector, smaller: Number) -> Vector:
    """How far the point is outside of each of a rectangle's four edges, in m; below 0 inside."""
    over = [sign * x - half for x, half in zip(point, size, strict=False) for sign in (1.0, -1.0)]
    return [select(absolute(x) < _ON_LINE * smaller, 0.0, x) for x in over]


def starts(corners: list[Vector], outsides: list[Vector], is_forward: Number) -> list[tuple[Number, Vector]]:
    """Whether a part of each edge between corners [4][3] is inside of four lines, and where it starts.

    outsides: of each corner, how far it is outside of each line. is_forward: otherwise the part's end.
    """
    found = list[tuple[Number, Vector]]()
    for here, there in ((k, (k + 1) % 4) for k in range(4)):
        first: Number = 0.0
        last: Number = 1.0
        for one, other in zip(outsides[here], outsides[there], strict=True):
            is_out, gets_out = one > 0.0, other > 0.0
            crossing = one / select(absolute(one - other) < _SMALLEST, 1.0, one - other)
            first = maximum(first, select(is_out, select(gets_out, 2.0, crossing), 0.0))
            last = minimum(last, select(is_out, 1.0, select(gets_out, crossing, 1.0)))
        way = subtract(corners[there], corners[here])
        start = add(corners[here], scale(way, select(is_forward, first, last)))
        found.append((~(last < first), start))
    return found


def _different(points: list[tuple[Number, Vector]], nearest: Number) -> list[tuple[Number, Vector]]:
    """Those that exist and are no nearer than a distance, in m², to an earlier one, seen from above."""
    found = list[tuple[Number, Vector]]()
    for exists, point in points:
        for is_there, earlier in found:
            way = subtract(point[:2], earlier[:2])
            exists = exists & ~(is_there & (dot(way, way) < nearest))
        found.append((exists, point))
    return found
