"""Where spheres and capsules touch each other.

Source: MuJoCo's documentation, Computation, "Collision detection"; `mjc_SphereSphere` and its neighbours.
"""

from core.physics.compiled.collisions.shapes import Placed, Touch
from core.physics.compiled.program.arithmetic import (
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


def _between(one: Vector, radius: Number, other: Vector, radius_other: Number) -> Touch:
    """The contact of two spheres. Where their centres coincide, the normal is the x axis, unlike MuJoCo's."""
    way = subtract(other, one)
    length = sqrt(dot(way, way))
    is_one = length < _SMALLEST
    inverse = 1.0 / maximum(length, _SMALLEST)
    normal = [select(is_one, x, y) for x, y in zip([1.0, 0.0, 0.0], scale(way, inverse), strict=True)]
    distance = length - radius - radius_other
    return Touch(add(one, scale(normal, radius + 0.5 * distance)), distance, normal)
