"""Where spheres touch a box, which is always the second of the two.

Source: MuJoCo's documentation, Computation, "Collision detection"; `mjraw_SphereBox`.
"""

from mujoco_compiled.collisions.shapes import Placed, Touch
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
    sqrt,
    subtract,
)

_SMALLEST = 1e-15


def sphere_box(sphere: Placed, box: Placed) -> list[Touch]:
    """One point."""
    local = box.inward(subtract(sphere.position, box.position))
    return [ball_in_box(local, sphere.size[0], box)]


def ball_in_box(centre: Vector, radius: Number, box: Placed) -> Touch:
    """The contact of a box and a sphere whose centre [3] is in the box's frame."""
    nearest = [clip(x, -size, size) for x, size in zip(centre, box.size, strict=True)]
    way = subtract(nearest, centre)
    length = sqrt(dot(way, way))
    is_inside = length < _SMALLEST
    depth, through = _nearest_face(centre, box)
    inverse = 1.0 / maximum(length, _SMALLEST)
    normal = [select(is_inside, x, y * inverse) for x, y in zip(through, way, strict=True)]
    distance = select(is_inside, -depth, length) - radius
    position = add(centre, scale(normal, radius + 0.5 * distance))
    return Touch(add(box.position, box.outward(position)), distance, box.outward(normal))


def _nearest_face(centre: Vector, box: Placed) -> tuple[Number, Vector]:
    """How deep a point inside is below the nearest face, and that face's normal into the box."""
    depths = [size - absolute(x) for x, size in zip(centre, box.size, strict=True)]
    inwards = [select(x > 0.0, -1.0, 1.0) for x in centre]
    is_x = ~(depths[1] < depths[0]) & ~(depths[2] < depths[0])
    is_z = depths[2] < minimum(depths[0], depths[1])
    x = select(is_x, inwards[0], 0.0)
    z = select(is_z, inwards[2], 0.0)
    y = select(~is_x & ~is_z, inwards[1], 0.0)
    return minimum(minimum(depths[0], depths[1]), depths[2]), [x, y, z]
