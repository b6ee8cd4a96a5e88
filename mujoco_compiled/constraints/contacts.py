"""The rows of geoms that touch.

Source: MuJoCo's documentation, Computation, "Constraint model", "Contacts".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import compress
from operator import and_

import mujoco

from mujoco_compiled.collisions.fixed_boxes import (
    Choice,
    Shape,
    chosen_box,
    chosen_parameters,
    merged,
    near,
)
from mujoco_compiled.collisions.own_boxes import own_boxes
from mujoco_compiled.collisions.shapes import Geom, Placed, Touch, placed, read_geoms
from mujoco_compiled.collisions.table import CHEAP, COLLIDERS
from mujoco_compiled.constraints.body_rows import BodyGroup
from mujoco_compiled.constraints.cone import Cone
from mujoco_compiled.constraints.laws import Law, OneSided, Pyramid
from mujoco_compiled.constraints.pairs import ContactParameters, Pair, read_pairs
from mujoco_compiled.constraints.rows import Direction, RowGroup
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
from mujoco_compiled.smooth.dynamics import Motion
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.tree import Tree


@dataclass(frozen=True)
class ContactPair:
    """Two geoms that can touch, the second maybe chosen of several that are fixed.

    inverse_weight: MuJoCo's `body_invweight0` of both bodies, of translations. is_elliptic: the friction
    cone is a cone, not a pyramid. impratio: MuJoCo's.
    """

    one: Geom
    other: Shape
    parameters: ContactParameters
    inverse_weight: Number
    is_elliptic: bool
    impratio: float

    @property
    def kinds(self) -> tuple[int, int]:
        """Both geoms', of `mjtGeom`."""
        return self.one.kind, self.other.kind

    @property
    def num_points(self) -> int:
        """Where it may push at once."""
        return COLLIDERS[self.kinds][1]

    @property
    def num_rows(self) -> int:
        """Edges of pyramids, or directions of cones."""
        num_friction = len(self.parameters.friction)
        at_a_point = 2 * num_friction if num_friction and not self.is_elliptic else 1 + num_friction
        return self.num_points * at_a_point


def read_contacts(fields: Fields) -> tuple[ContactPair, ...]:
    """All that can touch and move."""
    model = fields.model
    geoms = read_geoms(fields)
    pairs, nominal = read_pairs(fields), [pair.parameters for pair in read_pairs(Fields(model))]
    moves = [bool(geoms[pair.one].body or geoms[pair.other].body) for pair in pairs]
    pairs, nominal = list(compress(pairs, moves)), list(compress(nominal, moves))
    return tuple(
        ContactPair(
            one=geoms[pair.one],
            other=other,
            parameters=pair.parameters,
            inverse_weight=_inverse_weight(fields, pair),
            is_elliptic=model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC,
            impratio=float(model.opt.impratio),
        )
        for pair, other in merged(pairs, nominal, geoms, own_boxes(fields))
    )


def is_better_by_body(tree: Tree, contacts: Sequence[ContactPair]) -> bool:
    """Whether contacts take fewer operations at each of the solver's iterations as `body_rows` has them."""
    one_by_one, by_body = 0, 11 * len(tree.entries) + 66 * len(tree.dofs)
    for contact in contacts:
        if contact.one.body and contact.other.body:
            continue
        size = len(_moved_by(tree, contact.one.body or contact.other.body))
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
    one = placed(contact.one, at)
    if isinstance(contact.other, Choice):
        is_near = near(contact.other, one.position)
        other = chosen_box(contact.other, is_near)
        contact = replace(contact, parameters=chosen_parameters(contact.other, is_near))
    else:
        other = placed(contact.other, at)
    touches = _touches(contact, one, other, skips=skips)
    is_single = not (contact.one.body and contact.other.body)

    def groups() -> list[RowGroup | BodyGroup]:
        return [_group(tree, contact, touch, moving, by_body=by_body and is_single) for touch in touches]

    distances = [touch.distance for touch in touches]
    if skips:
        may_push = reduce(minimum, distances) < contact.parameters.margin
        return list(zip(distances, groups_where(may_push, groups), strict=True))
    return list(zip(distances, groups(), strict=True))


def _touches(contact: ContactPair, one: Placed, other: Placed, *, skips: bool) -> list[Touch]:
    collide, _ = COLLIDERS[contact.kinds]
    if not skips or contact.kinds in CHEAP:
        return collide(one, other)
    return touches_where(_are_close(contact, one, other), lambda: collide(one, other))


def _are_close(contact: ContactPair, one: Placed, other: Placed) -> Number:
    """Whether the spheres about the geoms are near enough for them to touch."""
    reach, way = contact.parameters.reach, subtract(one.position, other.position)
    if contact.other.kind == mujoco.mjtGeom.mjGEOM_BOX and contact.one.kind != mujoco.mjtGeom.mjGEOM_PLANE:
        sides = zip(other.inward(way), other.size, strict=True)
        return reduce(and_, (absolute(x) < size + contact.one.bound + reach for x, size in sides))
    if contact.one.kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return -dot(one.axis, way) < contact.other.bound + reach
    return dot(way, way) < squared(contact.one.bound + contact.other.bound + reach)


def _group(
    tree: Tree, contact: ContactPair, touch: Touch, moving: Motion, *, by_body: bool
) -> RowGroup | BodyGroup:
    parameters, distance = contact.parameters, touch.distance - contact.parameters.margin
    axes = _axes(contact, touch)
    sides = _sides(tree, contact, touch, moving)
    speeds = [
        total(dot(axis, side.at_point(moving.velocities[side.body], turns)) for side in sides)
        for axis, turns in axes
    ]
    impedance = impedance_at(parameters.spring.impedance, distance)
    damping = parameters.friction_damping if contact.is_elliptic else parameters.spring.damping
    normal = reference_at(parameters.spring, impedance, distance, speeds[0])
    reference = [normal, *(-damping * speed for speed in speeds[1:])]
    law = _law(contact, impedance, distance)
    if by_body:
        return BodyGroup(sides[0].body, [sides[0].wrench(*axis) for axis in axes], reference, law)
    return RowGroup([_direction(sides, moving, *axis) for axis in axes], reference, law)


def _law(contact: ContactPair, impedance: Number, distance: Number) -> Law:
    friction, weight = contact.parameters.friction, contact.inverse_weight
    if not friction:
        return OneSided(stiffness_at(impedance, weight, distance))
    # The slope of the cone that `impratio` regularises.
    slope = friction[0] / contact.impratio**0.5
    if contact.is_elliptic:
        return Cone(stiffness_at(impedance, weight, distance), slope, friction)
    edge = weight * (1.0 + squared(friction[0])) * 2.0 * squared(slope)
    return Pyramid(stiffness_at(impedance, edge, distance), friction)


def _inverse_weight(fields: Fields, pair: Pair) -> Number:
    bodies = fields.model.geom_bodyid[[pair.one, pair.other]]
    return total(fields.number("body_invweight0", int(body)) for body in bodies)


@dataclass(frozen=True)
class _Side:
    """A body that moves. sign: 1 for the second, -1 for the first. arm: [3], from its tree's centre to the
    point. dofs: those that move this body alone."""

    body: int
    sign: float
    arm: Vector
    dofs: list[int]

    def at_point(self, motion: Vector, turns: bool) -> Vector:
        """How a motion [6] of the body turns it or moves the point, [3]."""
        turn, way = motion[:3], motion[3:]
        return scale(turn if turns else add(way, cross(turn, self.arm)), self.sign)

    def wrench(self, axis: Vector, turns: bool) -> Vector:
        """The spatial force [6] that does the same work as one along an axis at the point, or about it."""
        force = scale(axis, self.sign)
        return [*force, 0.0, 0.0, 0.0] if turns else [*cross(self.arm, force), *force]


def _axes(contact: ContactPair, touch: Touch) -> list[tuple[Vector, bool]]:
    """The normal, and as many of both tangents, turning about the normal and rolling as there is friction:
    each with whether it turns."""
    num = 1 + len(contact.parameters.friction)
    frame = [touch.normal, *(_tangents(touch.normal, touch.along) if num > 1 else ())]
    return [(axis, turns) for turns in (False, True) for axis in frame][:num]


def _sides(tree: Tree, contact: ContactPair, touch: Touch, moving: Motion) -> list[_Side]:
    bodies = contact.one.body, contact.other.body
    moves = [_moved_by(tree, body) for body in bodies]
    found = list[_Side]()
    for body, own, others, sign in zip(bodies, moves, reversed(moves), (-1.0, 1.0), strict=True):
        if body:
            arm = subtract(touch.position, moving.centres[tree.bodies[body].root])
            found.append(_Side(body, sign, arm, [i for i in own if i not in others]))
    return found


def _direction(sides: Sequence[_Side], moving: Motion, axis: Vector, turns: bool) -> Direction:
    return {i: dot(axis, side.at_point(moving.axes[i], turns)) for side in sides for i in side.dofs}


def _moved_by(tree: Tree, body: int) -> list[int]:
    """The degrees of freedom that move the body."""
    while body:
        own = [i for i, dof in enumerate(tree.dofs) if dof.body == body]
        if own:
            return [*tree.dofs[own[-1]].ancestors, own[-1]]
        body = tree.bodies[body].parent
    return []


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
