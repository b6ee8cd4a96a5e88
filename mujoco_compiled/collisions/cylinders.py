"""Where spheres touch a cylinder, which is always the second of the two.

Source: MuJoCo's documentation, Computation, "Collision detection"; `mjc_SphereCylinder`.
"""

from mujoco_compiled.collisions.shapes import Placed, Touch
from mujoco_compiled.program.arithmetic import (
    absolute,
    add,
    clip,
    maximum,
    minimum,
    scale,
    select,
    sqrt,
    subtract,
)

_SMALLEST = 1e-15


def sphere_cylinder(sphere: Placed, cylinder: Placed) -> list[Touch]:
    """One point, in the plane of the cylinder's axis and the sphere's centre."""
    (radius, half, _), ball = cylinder.size, sphere.size[0]
    x, y, height = cylinder.inward(subtract(sphere.position, cylinder.position))
    across = sqrt(x * x + y * y)
    # A centre on the axis looks along x, as every way out is as long.
    is_on_axis = across < _SMALLEST
    inverse = 1.0 / maximum(across, _SMALLEST)
    ways = select(is_on_axis, 1.0, x * inverse), select(is_on_axis, 0.0, y * inverse)
    beyond, above = across - minimum(across, radius), height - clip(height, -half, half)
    length = sqrt(beyond * beyond + above * above)
    # Inside, the nearer of the side and an end is the way out.
    to_side, to_end = radius - across, half - absolute(height)
    is_inside, by_side = length < _SMALLEST, to_side < to_end
    upwards = select(height < 0.0, -1.0, 1.0)
    inverse = 1.0 / maximum(length, _SMALLEST)
    outwards = select(is_inside, select(by_side, 1.0, 0.0), beyond * inverse)
    along = select(is_inside, select(by_side, 0.0, upwards), above * inverse)
    distance = select(is_inside, -minimum(to_side, to_end), length) - ball
    normal = cylinder.outward([-outwards * ways[0], -outwards * ways[1], -along])
    return [Touch(add(sphere.position, scale(normal, ball + 0.5 * distance)), distance, normal)]
