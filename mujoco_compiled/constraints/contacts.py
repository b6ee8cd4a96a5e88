"""Where two geoms touch, and how they push there.

Source: MuJoCo's documentation, Computation, "Constraint model", "Contacts".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import compress
from operator import and_

import mujoco

from mujoco_compiled.collisions.fields import read_field
from mujoco_compiled.collisions.hulls import read_hull
from mujoco_compiled.collisions.prisms import num_field_points
from mujoco_compiled.collisions.shapes import Geom, Placed, Touch, placed, read_geoms
from mujoco_compiled.collisions.table import CHEAP, COLLIDERS
from mujoco_compiled.constraints.body_rows import BodyGroup
from mujoco_compiled.constraints.cone import Cone
from mujoco_compiled.constraints.laws import Direction, Law, OneSided, Pyramid, RowGroup
from mujoco_compiled.constraints.pairs import ContactParameters, Pair, read_pairs
from mujoco_compiled.constraints.skipping import groups_where, touches_where
from mujoco_compiled.constraints.solref import impedance_at, reference_at, stiffness_at
from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    absolute,
    add,
    cross,
    dot,
    maximum,
    minimum,
    scale,
    select,
    sqrt,
    squared,
    subtract,
    total,
)
from mujoco_compiled.program.memory import Index
from mujoco_compiled.smooth.dynamics import Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.tree import Tree

# Of contacts whose slots look alike: the number of directions, and whether each side's body moves.
Looks = tuple[int, bool, bool]


@dataclass(frozen=True)
class ContactPair:
    """Two geoms that can touch.

    inverse_weight: MuJoCo's `body_invweight0` of both bodies, of translations. is_elliptic: the friction
    cone is a cone, not a pyramid. impratio: MuJoCo's.
    """

    one: Geom
    other: Geom
    parameters: ContactParameters
    inverse_weight: Number
    is_elliptic: bool
    impratio: float

    @property
    def kinds(self) -> tuple[int, int]:
        """Both geoms', of `mjtGeom`."""
        return self.one.kind, self.other.kind

    @property
    def bodies(self) -> tuple[int, int]:
        return self.one.body, self.other.body

    @property
    def num_directions(self) -> int:
        """The normal, and one for each friction."""
        return 1 + len(self.parameters.friction)

    @property
    def looks(self) -> Looks:
        return self.num_directions, bool(self.one.body), bool(self.other.body)

    @property
    def num_points(self) -> int:
        """Where it may push at once."""
        window = self.window
        return COLLIDERS[self.kinds][1] if window is None else num_field_points(window)

    @property
    def window(self) -> tuple[int, int] | None:
        """Over how many cells of a height field the other geom may be; see `HeightField`."""
        return self.one.field and self.one.field.window(self.other.bound + max(0.0, self.parameters.reach))


@dataclass(frozen=True)
class Side:
    """A body that a contact moves, by its number. sign: 1 for the second geom's, -1 for the first's. arm:
    [3], from its tree's centre to the point."""

    body: Index
    sign: Number
    arm: Vector

    def at_point(self, motion: Vector, turns: bool) -> Vector:
        """How a motion [6] of the body turns it or moves the point, [3]."""
        turn, way = motion[:3], motion[3:]
        return scale(turn if turns else add(way, cross(turn, self.arm)), self.sign)

    def wrench(self, axis: Vector, turns: bool) -> Vector:
        """The spatial force [6] that does the same work as one along an axis at the point, or about it."""
        force = scale(axis, self.sign)
        return [*force, 0.0, 0.0, 0.0] if turns else [*cross(self.arm, force), *force]


@dataclass(frozen=True)
class Push:
    """How a contact pushes at a point. axes: the directions [3], each with whether it turns. reference: by
    direction, the wanted acceleration."""

    axes: list[tuple[Vector, bool]]
    reference: Vector
    law: Law


def read_contacts(fields: Fields) -> tuple[ContactPair, ...]:
    """All that can touch and move."""
    model = fields.model
    geoms, pairs = list(read_geoms(fields)), read_pairs(fields)
    moves = [bool(geoms[pair.one].body or geoms[pair.other].body) for pair in pairs]
    for number in {number for pair in compress(pairs, moves) for number in (pair.one, pair.other)}:
        hull, field = read_hull(model, number), read_field(model, number)
        geoms[number] = replace(geoms[number], hull=hull, field=field)
    return tuple(
        ContactPair(
            one=geoms[pair.one],
            other=geoms[pair.other],
            parameters=pair.parameters,
            inverse_weight=_inverse_weight(fields, pair),
            is_elliptic=model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC,
            impratio=float(model.opt.impratio),
        )
        for pair in compress(pairs, moves)
    )


def is_better_by_body(tree: Tree, contacts: Sequence[ContactPair]) -> bool:
    """Whether contacts take fewer operations at each of the solver's iterations as `body_rows` has them."""
    one_by_one, by_body = 0, 11 * len(tree.entries) + 66 * len(tree.dofs)
    for contact in contacts:
        if contact.one.body and contact.other.body:
            continue
        size = len(tree.bodies[contact.one.body or contact.other.body].moved_by)
        # Operations for the curvature, the residual and the forces, with three directions.
        one_by_one += contact.num_points * (size * (size + 1) // 2 * 5 + size * 23)
        by_body += contact.num_points * 240
    return by_body < one_by_one


def contact_rows(
    tree: Tree, contact: ContactPair, at: Poses, moving: Motion, *, by_body: bool, skips: bool
) -> list[tuple[Number, RowGroup | BodyGroup]]:
    """For each point of the contact: how far apart the geoms are there, in m, and a group.

    skips: whether to compute nothing that geoms which do not touch have no need of. Their distance then is
    more than it can be where they touch.
    """
    one, other = placed(contact.one, at), placed(contact.other, at)
    collide, _ = COLLIDERS[contact.kinds]

    def touching() -> list[Touch]:
        return collide(one, other)

    skips_points = skips and contact.kinds not in CHEAP
    touches = touches_where(are_close(contact, one, other), touching) if skips_points else touching()

    def groups() -> list[RowGroup | BodyGroup]:
        return [_group(tree, contact, touch, moving, by_body=by_body) for touch in touches]

    distances = [touch.distance for touch in touches]
    if skips:
        may_push = reduce(minimum, distances) < contact.parameters.margin
        return list(zip(distances, groups_where(may_push, groups), strict=True))
    return list(zip(distances, groups(), strict=True))


def are_close(contact: ContactPair, one: Placed, other: Placed) -> Number:
    """Whether the sphere about the first geom is near enough to the second, or to what is about it."""
    way = subtract(one.position, other.position)
    near = contact.one.bound + maximum(0.0, contact.parameters.reach)
    kind, kind_other = contact.kinds
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        if other.hull is not None:
            return _is_low(one, other, near)
        return -dot(one.axis, way) < near + contact.other.bound
    if one.field is not None:
        return _is_over(one, other, contact.other.bound + maximum(0.0, contact.parameters.reach))
    if other.hull is not None:
        sides = zip(subtract(other.inward(way), other.hull.middle), other.hull.half, strict=True)
        return reduce(and_, (absolute(x) < half + near for x, half in sides))
    if kind_other == mujoco.mjtGeom.mjGEOM_BOX:
        sides = zip(other.inward(way), other.size, strict=True)
        return reduce(and_, (absolute(x) < size + near for x, size in sides))
    return dot(way, way) < squared(near + contact.other.bound)


def _is_low(plane: Placed, mesh: Placed, near: Number) -> Number:
    """Whether the box about a mesh is nearer to a plane than that."""
    assert mesh.hull is not None  # noqa: S101
    upwards = mesh.inward(plane.axis)
    reach = total(absolute(x) * half for x, half in zip(upwards, mesh.hull.half, strict=True))
    height = dot(plane.axis, subtract(mesh.position, plane.position)) + dot(upwards, mesh.hull.middle)
    return height - reach < near


def _is_over(field: Placed, geom: Placed, near: Number) -> Number:
    """Whether a geom is nearer than this to the box about a height field."""
    assert field.field is not None  # noqa: S101
    *across, up = field.inward(subtract(geom.position, field.position))
    is_over = (up < field.field.top + near) & (-field.field.base - near < up)
    return reduce(
        and_, (absolute(x) < h + near for x, h in zip(across, field.field.half, strict=True)), is_over
    )


def push(contact: ContactPair, touch: Touch, sides: Sequence[tuple[Side, Vector]]) -> Push:
    """sides: those that move, each with its body's velocity [6]."""
    parameters, distance = contact.parameters, touch.distance - contact.parameters.margin
    axes = directions(contact.num_directions, touch)
    speeds = [
        total(dot(axis, side.at_point(velocity, turns)) for side, velocity in sides) for axis, turns in axes
    ]
    impedance = impedance_at(parameters.spring.impedance, distance)
    damping = parameters.friction_damping if contact.is_elliptic else parameters.spring.damping
    normal = reference_at(parameters.spring, impedance, distance, speeds[0])
    reference = [normal, *(-damping * speed for speed in speeds[1:])]
    stiffness = stiffness_at(impedance, _row_weight(contact), distance)
    return Push(axes, reference, law_of(contact, parameters.friction, stiffness))


def law_of(contact: ContactPair, friction: Sequence[Number], stiffness: Number) -> Law:
    """The contact's law, with this friction and stiffness."""
    if not friction:
        return OneSided(stiffness)
    if contact.is_elliptic:
        return Cone(stiffness, _slope_of_cone(contact, friction), friction)
    return Pyramid(stiffness, friction)


def directions(number: int, touch: Touch) -> list[tuple[Vector, bool]]:
    """The normal, and as many of both tangents, turning about the normal and rolling as there is friction:
    each with whether it turns."""
    frame = [touch.normal, *(_tangents(touch.normal, touch.along) if number > 1 else ())]
    return [(axis, turns) for turns in (False, True) for axis in frame][:number]


def moved_apart(tree: Tree, bodies: tuple[int, int]) -> tuple[list[int], list[int]]:
    """For each of two bodies, the degrees of freedom that move it alone."""
    one, other = (tree.bodies[body].moved_by for body in bodies)
    return [i for i in one if i not in other], [i for i in other if i not in one]


def _slope_of_cone(contact: ContactPair, friction: Sequence[Number]) -> Number:
    """The slope of the cone that `impratio` regularises."""
    return friction[0] / contact.impratio**0.5


def _row_weight(contact: ContactPair) -> Number:
    """The inverse weight by which MuJoCo makes a row stiff."""
    friction, weight = contact.parameters.friction, contact.inverse_weight
    if not friction or contact.is_elliptic:
        return weight
    return weight * (1.0 + squared(friction[0])) * 2.0 * squared(_slope_of_cone(contact, friction))


def _group(
    tree: Tree, contact: ContactPair, touch: Touch, moving: Motion, *, by_body: bool
) -> RowGroup | BodyGroup:
    sides, velocities, dofs = list[Side](), list[Vector](), list[list[int]]()
    for body, own, sign in zip(contact.bodies, moved_apart(tree, contact.bodies), (-1.0, 1.0), strict=True):
        if body:
            arm = subtract(touch.position, moving.centres[tree.bodies[body].root])
            sides.append(Side(body, sign, arm))
            velocities.append(moving.velocities[body])
            dofs.append(own)
    found = push(contact, touch, list(zip(sides, velocities, strict=True)))
    if by_body and len(sides) == 1:
        wrenches = [sides[0].wrench(*axis) for axis in found.axes]
        return BodyGroup(contact.one.body or contact.other.body, wrenches, found.reference, found.law)
    rows: list[Direction] = [
        {
            i: dot(axis, side.at_point(moving.axes[i], turns))
            for side, own in zip(sides, dofs, strict=True)
            for i in own
        }
        for axis, turns in found.axes
    ]
    return RowGroup(rows, found.reference, found.law)


def _inverse_weight(fields: Fields, pair: Pair) -> Number:
    bodies = fields.model.geom_bodyid[[pair.one, pair.other]]
    return total(fields.number("body_invweight0", int(body)) for body in bodies)


def _tangents(normal: Vector, along: Vector | None) -> tuple[Vector, Vector]:
    """Two directions at right angles to the normal and to each other, those of `mju_makeFrame`."""
    if along is None:
        if all(isinstance(x, float) for x in normal):
            along = [0.0, 1.0, 0.0] if abs(normal[1]) < 0.5 else [0.0, 0.0, 1.0]
        else:
            is_across = absolute(normal[1]) < 0.5
            along = [0.0, select(is_across, 1.0, 0.0), select(is_across, 0.0, 1.0)]
    across = subtract(along, scale(normal, dot(normal, along)))
    length = sqrt(dot(across, across))
    first = scale(across, 1.0 / maximum(length, 1e-15))
    return first, cross(normal, first)
