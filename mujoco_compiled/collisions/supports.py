"""Convex geoms by their support: the point that lies farthest in a direction.

A geom is a core with a ball of some radius swept over it: a sphere is a ball about a point, a capsule one
along a line. The general routine sees cores alone, as flat and sharp things take it the fewest steps.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import mujoco

from mujoco_compiled.collisions.shapes import Placed
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    add,
    dot,
    maximum,
    product,
    rotate,
    scale,
    select,
    sqrt,
    subtract,
    transpose,
)

SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)
_SMALLEST = 1e-15


class Body(Protocol):
    """What the general routine sees.

    position: [3] in m, a point inside. size: [3] in m, about how large it is. radius: of the ball that is
    swept over the core, in m.
    """

    @property
    def position(self) -> Vector: ...

    @property
    def size(self) -> Vector: ...

    @property
    def radius(self) -> Number: ...

    def support(self, direction: Vector) -> Vector:
        """The core's point [3] that is farthest in a direction [3] of any length but 0."""
        ...

    def normals(self, way: Vector) -> list[Vector]:
        """Directions [3] of which one is likely to be near a contact's normal. way: to the other's centre."""
        ...


@dataclass(frozen=True)
class Convex:
    """A geom where it is. to_world: its axes in the world, as columns."""

    kind: int
    geom: Placed
    to_world: Matrix

    @property
    def position(self) -> Vector:
        return self.geom.position

    @property
    def size(self) -> Vector:
        return self.geom.size

    @property
    def radius(self) -> Number:
        return self.geom.size[0] if self.kind in (SPHERE, CAPSULE) else 0.0

    def support(self, direction: Vector) -> Vector:
        if self.kind == SPHERE:
            return self.geom.position
        local = rotate(transpose(self.to_world), direction)
        return add(self.geom.position, rotate(self.to_world, _SUPPORTS[self.kind](self.geom, local)))

    def normals(self, way: Vector) -> list[Vector]:
        axes = transpose(self.to_world)
        found = {SPHERE: [], CAPSULE: [], CYLINDER: axes[2:]}.get(self.kind, axes)
        if self.kind in (CAPSULE, CYLINDER):
            across = subtract(way, scale(axes[2], dot(axes[2], way)))
            found = [*found, unit_or(across, axes[0])]
        return found


def unit_or(vector: Vector, otherwise: Vector) -> Vector:
    """A vector's direction [3]; another one where the vector is 0."""
    length = sqrt(dot(vector, vector))
    is_none, inverse = length < _SMALLEST, 1.0 / maximum(length, _SMALLEST)
    return [select(is_none, other, x * inverse) for x, other in zip(vector, otherwise, strict=True)]


def convex_geom(kind: int, geom: Placed) -> Convex:
    return Convex(kind, geom, product(geom.to_world, geom.to_body))


def _of_capsule(geom: Placed, direction: Vector) -> Vector:
    return [0.0, 0.0, _towards(direction[2], geom.size[1])]


def _of_ellipsoid(geom: Placed, direction: Vector) -> Vector:
    scaled = [x * size for x, size in zip(direction, geom.size, strict=True)]
    length = sqrt(dot(scaled, scaled))
    return [x * size / length for x, size in zip(scaled, geom.size, strict=True)]


def _of_cylinder(geom: Placed, direction: Vector) -> Vector:
    x, y, z = direction
    radius, half, _ = geom.size
    factor = radius / maximum(sqrt(x * x + y * y), _SMALLEST)
    return [x * factor, y * factor, _towards(z, half)]


def _of_box(geom: Placed, direction: Vector) -> Vector:
    return [_towards(x, size) for x, size in zip(direction, geom.size, strict=True)]


def _of_mesh(geom: Placed, direction: Vector) -> Vector:
    assert geom.hull is not None  # noqa: S101
    return geom.hull.farthest(direction)


def _towards(direction: Number, size: Number) -> Number:
    return select(direction < 0.0, -size, size)


_SUPPORTS: Mapping[int, Callable[[Placed, Vector], Vector]] = {
    CAPSULE: _of_capsule,
    ELLIPSOID: _of_ellipsoid,
    CYLINDER: _of_cylinder,
    BOX: _of_box,
    MESH: _of_mesh,
}
