"""Which kinds of geoms have a contact, and what computes it."""

from collections.abc import Callable, Mapping

import mujoco

from mujoco_compiled.collisions.box_box import box_box, box_box_gap
from mujoco_compiled.collisions.boxes import sphere_box
from mujoco_compiled.collisions.capsule_box import capsule_box, capsule_box_gap
from mujoco_compiled.collisions.cylinder_box import cylinder_box
from mujoco_compiled.collisions.cylinders import sphere_cylinder
from mujoco_compiled.collisions.ellipsoid_box import ellipsoid_box
from mujoco_compiled.collisions.faces import convex_collider, num_convex_points
from mujoco_compiled.collisions.planes import (
    plane_box,
    plane_capsule,
    plane_cylinder,
    plane_ellipsoid,
    plane_mesh,
    plane_sphere,
)
from mujoco_compiled.collisions.shapes import Placed, Touch
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    clip,
    dot,
    maximum,
    scale,
    select,
    sqrt,
    subtract,
)

_SMALLEST = 1e-15


def sphere_sphere(one: Placed, other: Placed) -> list[Touch]:
    """One point."""
    return [_between(one.position, one.size[0], other.position, other.size[0])]


def sphere_capsule(sphere: Placed, capsule: Placed) -> list[Touch]:
    """One point, at the place of the capsule that is nearest."""
    axis, half = capsule.axis, capsule.size[1]
    nearest = clip(dot(axis, subtract(sphere.position, capsule.position)), -half, half)
    centre = add(capsule.position, scale(axis, nearest))
    return [_between(sphere.position, sphere.size[0], centre, capsule.size[0])]


def capsule_capsule(one: Placed, other: Placed) -> list[Touch]:
    """One point, where the capsules are nearest to each other. MuJoCo has two where they are parallel."""
    (radius, half, _), (radius_other, half_other, _) = one.size, other.size
    axis, axis_other = one.axis, other.axis
    apart = subtract(one.position, other.position)
    cosine, from_one, from_other = dot(axis, axis_other), -dot(axis, apart), dot(axis_other, apart)
    sine_squared = maximum(1.0 - cosine * cosine, _SMALLEST)
    place = clip((from_one + cosine * from_other) / sine_squared, -half, half)
    place_other = clip(from_other + cosine * place, -half_other, half_other)
    place = clip(from_one + cosine * place_other, -half, half)
    centre = add(one.position, scale(axis, place))
    centre_other = add(other.position, scale(axis_other, place_other))
    return [_between(centre, radius, centre_other, radius_other)]


def capsule_gap(one: Placed, other: Placed) -> Number:
    """How far apart capsules are, or cylinders, which are within capsules of their length, at least."""
    return capsule_capsule(one, other)[0].distance


def _between(one: Vector, radius: Number, other: Vector, radius_other: Number) -> Touch:
    """The contact of two spheres. Where their centres coincide, the normal is the x axis, unlike MuJoCo's."""
    way = subtract(other, one)
    length = sqrt(dot(way, way))
    is_one = length < _SMALLEST
    inverse = 1.0 / maximum(length, _SMALLEST)
    normal = [select(is_one, x, y) for x, y in zip([1.0, 0.0, 0.0], scale(way, inverse), strict=True)]
    distance = length - radius - radius_other
    return Touch(add(one, scale(normal, radius + 0.5 * distance)), distance, normal)


Collider = Callable[[Placed, Placed], list[Touch]]
_PLANE, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)

# By the kinds of both geoms, in MuJoCo's order: what computes the points, and how many there are.
COLLIDERS: Mapping[tuple[int, int], tuple[Collider, int]] = {
    (_PLANE, _SPHERE): (plane_sphere, 1),
    (_PLANE, _CAPSULE): (plane_capsule, 2),
    (_PLANE, _ELLIPSOID): (plane_ellipsoid, 1),
    (_PLANE, _CYLINDER): (plane_cylinder, 4),
    (_PLANE, _BOX): (plane_box, 4),
    (_PLANE, _MESH): (plane_mesh, 4),
    (_SPHERE, _SPHERE): (sphere_sphere, 1),
    (_SPHERE, _CAPSULE): (sphere_capsule, 1),
    (_SPHERE, _CYLINDER): (sphere_cylinder, 1),
    (_SPHERE, _BOX): (sphere_box, 1),
    (_CAPSULE, _CAPSULE): (capsule_capsule, 1),
    (_CAPSULE, _BOX): (capsule_box, 2),
    (_ELLIPSOID, _BOX): (ellipsoid_box, 1),
    (_CYLINDER, _BOX): (cylinder_box, 4),
    (_BOX, _BOX): (box_box, 8),
    **{
        kinds: (convex_collider(*kinds), num_convex_points(*kinds))
        for kinds in (
            (_SPHERE, _ELLIPSOID),
            (_CAPSULE, _ELLIPSOID),
            (_CAPSULE, _CYLINDER),
            (_ELLIPSOID, _ELLIPSOID),
            (_ELLIPSOID, _CYLINDER),
            (_CYLINDER, _CYLINDER),
            *((kind, _MESH) for kind in (_SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX)),
        )
    },
}
# What is no more than the distance, and takes far fewer operations than the points.
GAPS: Mapping[tuple[int, int], Callable[[Placed, Placed], Number]] = {
    (_CAPSULE, _BOX): capsule_box_gap,
    (_CYLINDER, _BOX): capsule_box_gap,
    (_CAPSULE, _CYLINDER): capsule_gap,
    (_CYLINDER, _CYLINDER): capsule_gap,
    (_BOX, _BOX): box_box_gap,
}
# Where a look at whether geoms are near takes as long as to compute the points.
CHEAP = frozenset({(_PLANE, _SPHERE), (_PLANE, _CAPSULE), (_SPHERE, _SPHERE)})
