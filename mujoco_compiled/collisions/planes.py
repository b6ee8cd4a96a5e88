"""Where geoms touch a plane, which is always the first of the two.

Source: MuJoCo's documentation, Computation, "Collision detection"; `mjc_PlaneSphere` and its neighbours.
"""

from dataclasses import replace

from mujoco_compiled.collisions.shapes import AWAY, Placed, Touch
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    cross,
    dot,
    maximum,
    scale,
    select,
    sqrt,
    subtract,
)

_SMALLEST = 1e-15


def plane_sphere(plane: Placed, sphere: Placed) -> list[Touch]:
    """One point."""
    return [_below(plane, sphere.position, sphere.size[0])]


def plane_capsule(plane: Placed, capsule: Placed) -> list[Touch]:
    """The two ends; friction is along the capsule and across it."""
    axis = capsule.axis
    half = scale(axis, capsule.size[1])
    ends = add(capsule.position, half), subtract(capsule.position, half)
    return [_below(plane, end, capsule.size[0], axis) for end in ends]


def plane_ellipsoid(plane: Placed, ellipsoid: Placed) -> list[Touch]:
    """The lowest point."""
    local = [-x * size for x, size in zip(ellipsoid.inward(plane.axis), ellipsoid.size, strict=True)]
    along = scale(local, 1.0 / sqrt(dot(local, local)))
    lowest = ellipsoid.outward([x * size for x, size in zip(along, ellipsoid.size, strict=True)])
    return [_below(plane, add(ellipsoid.position, lowest), 0.0)]


def plane_box(plane: Placed, box: Placed) -> list[Touch]:
    """Four corners, no two of them opposite: of each two that are, the lower one."""
    edges = [box.outward([size if i == k else 0.0 for k in range(3)]) for i, size in enumerate(box.size)]
    found = list[Touch]()
    for x, y in ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)):
        corner = add(add(scale(edges[0], x), scale(edges[1], y)), edges[2])
        lower = select(dot(plane.axis, corner) > 0.0, -1.0, 1.0)
        found.append(_below(plane, add(box.position, scale(corner, lower)), 0.0))
    return found


def plane_cylinder(plane: Placed, cylinder: Placed) -> list[Touch]:
    """The lowest points of both rims, and two more of the lower rim: a triangle with its lowest."""
    normal, (radius, half, _) = plane.axis, cylinder.size
    slope = dot(normal, cylinder.axis)
    axis = scale(cylinder.axis, select(slope > 0.0, -half, half))
    across = subtract(scale(cylinder.axis, slope), normal)
    length = sqrt(dot(across, across))
    # A cylinder that stands upright has no lowest point: MuJoCo takes the one on its x axis.
    stands = length < _SMALLEST
    outward = scale(across, radius / maximum(length, _SMALLEST))
    upright = cylinder.outward([radius, 0.0, 0.0])
    down = [select(stands, x, y) for x, y in zip(upright, outward, strict=True)]
    aside = cross(down, axis)
    aside = scale(aside, 0.75**0.5 / half)
    lower, upper = add(cylinder.position, axis), subtract(cylinder.position, axis)
    middle = subtract(lower, scale(down, 0.5))
    points = [add(lower, down), add(upper, down), add(middle, aside), subtract(middle, aside)]
    return [_below(plane, point, 0.0) for point in points]


def plane_mesh(plane: Placed, mesh: Placed) -> list[Touch]:
    """Four corners, or three, of the face about the lowest vertex that is most level."""
    assert mesh.hull is not None  # noqa: S101
    corners, are_four = mesh.hull.lowest_face(scale(mesh.inward(plane.axis), -1.0))
    found = [_below(plane, add(mesh.position, mesh.outward(corner)), 0.0) for corner in corners]
    return [*found[:3], replace(found[3], distance=select(are_four, found[3].distance, AWAY))]


def _below(plane: Placed, centre: Vector, radius: Number, along: Vector | None = None) -> Touch:
    """The lowest point of a sphere."""
    normal = plane.axis
    gap = dot(normal, centre) - dot(normal, plane.position) - radius
    return Touch(subtract(centre, scale(normal, radius + 0.5 * gap)), gap, normal, along)
