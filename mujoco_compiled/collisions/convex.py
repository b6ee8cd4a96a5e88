"""Where any two convex geoms touch: at the direction in which they overlap least, or are farthest apart.

Along a unit vector n from the first to the second, the gap s(n) is between the first's farthest point along
n and the second's along -n. The contact's normal is where s is largest. The differences a - b of both
geoms' points are a convex set M, and no point of M is beyond the plane at -s(n) along n.

Where the geoms are apart, M lacks the origin, and the normal is the direction to the origin from the point
of M that is nearest: GJK finds it. Where they overlap, the origin is inside. So it is moved out, along the
best n so far, to a point q just outside of M. The direction to q from the point of M that is nearest to q
is no worse than n: of all n', it has the largest s(n') + |q| n'·n. So each search leads uphill, begins with
the simplex of the one before, and ends at a summit. There may be several summits where geoms overlap: the
start is the best of a few directions, such as the faces' normals.

Sources: Gilbert, Johnson and Keerthi (1988) for the search; the climb majorises as in Hunter and Lange
(2004). MuJoCo finds the same contact by expanding polytopes.
"""

from functools import reduce

from mujoco_compiled.collisions.shapes import Touch
from mujoco_compiled.collisions.supports import Body, unit_or
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
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
from mujoco_compiled.program.flow import repeat

# Between flat geoms six are enough; at round ones each leaves a part of the error.
_MOST_ITERATIONS = 20
# How far q is outside, as a part of the smaller geom's size. Much nearer, rounding would turn the direction.
_CLEARANCE = 0.1
# The squared move of a direction below which it has arrived.
_SMALLEST_MOVE = 1e-11
_SMALLEST, _LOWEST = 1e-15, -1e9


def convex_touch(one: Body, other: Body) -> Touch:
    """The point midway between both surfaces, where the gap is largest."""
    clearance = _CLEARANCE * minimum(*(reduce(maximum, body.size) for body in (one, other)))
    centre = [*subtract(one.position, other.position), *one.position]

    def improve(carried: list[Number]) -> tuple[list[Number], Number]:
        ahead, best, gap, *points = carried[:3], carried[3:6], carried[6], *_parted(carried[7:25], 6)
        found = _farthest(one, other, ahead)
        gap_ahead = -dot(ahead, found[:3])
        is_better = gap < gap_ahead
        best = [select(is_better, x, y) for x, y in zip(ahead, best, strict=True)]
        gap = select(is_better, gap_ahead, gap)
        outside = scale(best, maximum(clearance - gap, 0.0))
        nearest, kept = _nearest(found, points, outside)
        way = subtract(outside, nearest[:3])
        after = unit_or(way, ahead)
        move = subtract(after, ahead)
        return [*after, *best, gap, *found, *kept, *nearest[3:]], ~(dot(move, move) < _SMALLEST_MOVE)

    start = _best_start(one, other)
    carried = repeat(_MOST_ITERATIONS, improve, [*start, *start, _LOWEST, *centre * 3, *centre[3:]])
    normal, on_one = carried[3:6], carried[25:]
    distance = carried[6] - one.radius - other.radius
    return Touch(add(on_one, scale(normal, one.radius + 0.5 * distance)), distance, normal)


def _best_start(one: Body, other: Body) -> Vector:
    """Of the way between the centres and the geoms' own directions: the one with the largest gap."""
    way = subtract(other.position, one.position)
    directions = [unit_or(way, [0.0, 0.0, 1.0]), *one.normals(way), *other.normals(way)]

    def look(carried: list[Number]) -> tuple[list[Number], Number]:
        """At the first of the directions, which is then the last of them."""
        best, gap, ahead, rest = carried[:3], carried[3], carried[4:7], carried[7:]
        is_backwards = dot(ahead, way) < 0.0
        normal = [select(is_backwards, -x, x) for x in ahead]
        gap_ahead = -dot(normal, _farthest(one, other, normal)[:3])
        is_better = gap < gap_ahead
        best = [select(is_better, x, y) for x, y in zip(normal, best, strict=True)]
        return [*best, select(is_better, gap_ahead, gap), *rest, *ahead], True

    begun = [*directions[0], _LOWEST, *(x for direction in directions for x in direction)]
    return repeat(len(directions), look, begun)[:3]


def _farthest(one: Body, other: Body, direction: Vector) -> Vector:
    """The difference [3] that is farthest in a direction, and the first geom's point [3] that it is of."""
    on_one = one.support(direction)
    return [*subtract(on_one, other.support(scale(direction, -1.0))), *on_one]


def _nearest(new: Vector, points: list[Vector], target: Vector) -> tuple[Vector, Vector]:
    """The point that is nearest to a target [3], of all edges and triangles with the new point in a corner.

    points: three, [6] as those of `_farthest`. Also returns the numbers [12] of both other corners.
    """
    way, edges = subtract(new[:3], target), [subtract(point, new) for point in points]
    products = [[dot(edge[:3], other[:3]) for other in edges] for edge in edges]
    slopes = [dot(edge[:3], way) for edge in edges]
    found: tuple[Number, Vector, Vector] | None = None
    for i, edge in enumerate(edges):
        part = clip(-slopes[i] / maximum(products[i][i], _SMALLEST), 0.0, 1.0)
        on_edge = add(new, scale(edge, part))
        candidate = _squared_distance(on_edge, target), on_edge, [*points[i], *points[i]]
        found = candidate if found is None else _nearer(candidate, found, candidate[0] < found[0])
    assert found is not None  # noqa: S101
    for i, j in ((0, 1), (0, 2), (1, 2)):
        determinant = products[i][i] * products[j][j] - products[i][j] * products[i][j]
        inverse = 1.0 / maximum(determinant, _SMALLEST * _SMALLEST)
        first = (slopes[j] * products[i][j] - slopes[i] * products[j][j]) * inverse
        second = (slopes[i] * products[i][j] - slopes[j] * products[i][i]) * inverse
        inside = add(new, add(scale(edges[i], first), scale(edges[j], second)))
        candidate = _squared_distance(inside, target), inside, [*points[i], *points[j]]
        is_inside = (first > 0.0) & (second > 0.0) & (total([first, second]) < 1.0)
        found = _nearer(candidate, found, is_inside & (candidate[0] < found[0]))
    return found[1], found[2]


def _nearer(
    one: tuple[Number, Vector, Vector], other: tuple[Number, Vector, Vector], is_one: Number
) -> tuple[Number, Vector, Vector]:
    return (
        select(is_one, one[0], other[0]),
        [select(is_one, x, y) for x, y in zip(one[1], other[1], strict=True)],
        [select(is_one, x, y) for x, y in zip(one[2], other[2], strict=True)],
    )


def _squared_distance(point: Vector, target: Vector) -> Number:
    way = subtract(point[:3], target)
    return dot(way, way)


def _parted(numbers: Vector, size: int) -> list[Vector]:
    return [numbers[place : place + size] for place in range(0, len(numbers), size)]
