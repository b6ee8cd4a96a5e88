"""Where an ellipsoid touches a box: the direction in which they overlap least, or are farthest apart.

Along a unit vector n from the box to the ellipsoid the gap is n·c - Σ size |n| - √(nᵀAn), with the
ellipsoid's centre c and A = Σ r² a aᵀ of its axes a. The contact's normal is where the gap is largest: as a
rule that of a face, and at an edge or a corner something between those of its faces. It is found by climbing
from the best face. So deep in an edge, beyond a quarter of the ellipsoid's smallest radius, another direction
may be better. MuJoCo finds the same by expanding polytopes, by default to 1e-6 m, and some hundredths of the
normal at edges.
"""

from functools import reduce

from mujoco_compiled.collisions.shapes import Placed, Touch
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    absolute,
    add,
    dot,
    maximum,
    normalized,
    rotate,
    scale,
    select,
    sqrt,
    squared,
    subtract,
    total,
)
from mujoco_compiled.program.flow import repeat

# On a face one is enough; at edges and corners each leaves a part of the error.
_MOST_ITERATIONS = 60
# A unit vector's squared move below which single precision sees no difference.
_SMALLEST_MOVE = 1e-13


def ellipsoid_box(ellipsoid: Placed, box: Placed) -> list[Touch]:
    """One point, midway between the surfaces."""
    centre = box.inward(subtract(ellipsoid.position, box.position))
    spread = _spread(ellipsoid, box)
    # Twice the largest curvature keeps the steps from leaping over the summit.
    stiff = 2.0 * reduce(maximum, ellipsoid.size)

    def climb(carried: list[Number]) -> tuple[list[Number], Number]:
        """A step uphill, with the box's part by its proximal map: n's small components become exactly 0."""
        lowest, gap = _lowest(carried, centre, spread, box)
        step = 1.0 / (absolute(gap) + stiff)
        ahead = add(carried, scale(lowest, step))
        edges = [maximum(absolute(x) - step * size, 0.0) for x, size in zip(ahead, box.size, strict=True)]
        after = normalized([select(x < 0.0, -edge, edge) for x, edge in zip(ahead, edges, strict=True)])
        moved = subtract(after, carried)
        return after, ~(dot(moved, moved) < _SMALLEST_MOVE)

    normal = repeat(_MOST_ITERATIONS, climb, _nearest_face(centre, spread, box))
    lowest, gap = _lowest(normal, centre, spread, box)
    middle = subtract(lowest, scale(normal, 0.5 * gap))
    position = add(box.position, box.outward(middle))
    return [Touch(position, gap, scale(box.outward(normal), -1.0))]


def _lowest(normal: Vector, centre: Vector, spread: Matrix, box: Placed) -> tuple[Vector, Number]:
    """The ellipsoid's point that is deepest along a normal [3], in the box's frame, and the gap there."""
    towards = rotate(spread, normal)
    extent = sqrt(dot(normal, towards))
    reach = total(absolute(x) * size for x, size in zip(normal, box.size, strict=True))
    return subtract(centre, scale(towards, 1.0 / extent)), dot(normal, centre) - reach - extent


def _nearest_face(centre: Vector, spread: Matrix, box: Placed) -> Vector:
    """The normal of the face whose gap is largest."""
    gaps = [absolute(centre[k]) - box.size[k] - sqrt(spread[k][k]) for k in range(3)]
    is_x = ~(gaps[0] < gaps[1]) & ~(gaps[0] < gaps[2])
    is_z = (gaps[0] < gaps[2]) & (gaps[1] < gaps[2])
    chosen = [select(is_x, 1.0, 0.0), select(is_x, 0.0, select(is_z, 0.0, 1.0)), select(is_z, 1.0, 0.0)]
    return [select(x < 0.0, -one, one) for x, one in zip(centre, chosen, strict=True)]


def _spread(ellipsoid: Placed, box: Placed) -> Matrix:
    """A, in the box's frame."""
    units = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    axes = [box.inward(ellipsoid.outward(unit)) for unit in units]
    squares = [squared(size) for size in ellipsoid.size]
    return [
        [total(r * (a[i] * a[j]) for r, a in zip(squares, axes, strict=True)) for j in range(3)]
        for i in range(3)
    ]
