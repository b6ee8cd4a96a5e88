"""Which kinds of geoms have an exact contact, and what computes it."""

from collections.abc import Callable, Mapping

import mujoco

from core.physics.compiled.collisions.box_box import box_box
from core.physics.compiled.collisions.boxes import sphere_box
from core.physics.compiled.collisions.capsule_box import capsule_box
from core.physics.compiled.collisions.ellipsoid_box import ellipsoid_box
from core.physics.compiled.collisions.planes import (
    plane_box,
    plane_capsule,
    plane_cylinder,
    plane_ellipsoid,
    plane_sphere,
)
from core.physics.compiled.collisions.round import capsule_capsule, sphere_capsule, sphere_sphere
from core.physics.compiled.collisions.shapes import Placed, Touch

Collider = Callable[[Placed, Placed], list[Touch]]
_PLANE, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
)

# By the kinds of both geoms, in MuJoCo's order: what computes the points, and how many there are.
COLLIDERS: Mapping[tuple[int, int], tuple[Collider, int]] = {
    (_PLANE, _SPHERE): (plane_sphere, 1),
    (_PLANE, _CAPSULE): (plane_capsule, 2),
    (_PLANE, _ELLIPSOID): (plane_ellipsoid, 1),
    (_PLANE, _CYLINDER): (plane_cylinder, 4),
    (_PLANE, _BOX): (plane_box, 4),
    (_SPHERE, _SPHERE): (sphere_sphere, 1),
    (_SPHERE, _CAPSULE): (sphere_capsule, 1),
    (_SPHERE, _BOX): (sphere_box, 1),
    (_CAPSULE, _CAPSULE): (capsule_capsule, 1),
    (_CAPSULE, _BOX): (capsule_box, 2),
    (_ELLIPSOID, _BOX): (ellipsoid_box, 1),
    (_BOX, _BOX): (box_box, 8),
}
# Where a look at whether geoms are near takes as long as to compute the points.
CHEAP = frozenset({(_PLANE, _SPHERE), (_PLANE, _CAPSULE), (_SPHERE, _SPHERE)})
