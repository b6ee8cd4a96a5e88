"""The rows of geoms that touch.

Source: MuJoCo's documentation, Computation, "Constraint model", "Contacts".
"""

from dataclasses import dataclass

import mujoco

from core.physics.compiled.arithmetic import (
    Number,
    Vector,
    absolute,
    cross,
    dot,
    maximum,
    scale,
    select,
    sqrt,
    subtract,
    total,
)
from core.physics.compiled.collisions.fixed_boxes import Choice, Shape, chosen, merged
from core.physics.compiled.collisions.shapes import Geom, Touch, placed, read_geoms
from core.physics.compiled.collisions.table import COLLIDERS
from core.physics.compiled.cone import Cone
from core.physics.compiled.dynamics import Motion
from core.physics.compiled.kinematics import Poses
from core.physics.compiled.laws import Law, OneSided, Pyramid
from core.physics.compiled.pairs import Parameters, read_pairs
from core.physics.compiled.rows import Direction, Group
from core.physics.compiled.softness import impedance_at, reference_at, stiffness_at
from core.physics.compiled.tree import Tree


@dataclass(frozen=True)
class Contact:
    """Two geoms that can touch, the second maybe chosen of several that are fixed.

    inverse_weight: MuJoCo's `body_invweight0` of both bodies, of translations. is_elliptic: the friction
    cone is a cone, not a pyramid. impratio: MuJoCo's.
    """

    one: Geom
    other: Shape
    parameters: Parameters
    inverse_weight: float
    is_elliptic: bool
    impratio: float

    @property
    def kinds(self) -> tuple[int, int]:
        """Both geoms', of `mjtGeom`."""
        return self.one.kind, self.other.kind

    @property
    def num_rows(self) -> int:
        """Edges of pyramids, or directions of cones."""
        num_friction = len(self.parameters.friction)
        at_a_point = 2 * num_friction if num_friction and not self.is_elliptic else 1 + num_friction
        return COLLIDERS[self.kinds][1] * at_a_point


def read_contacts(model: mujoco.MjModel) -> tuple[Contact, ...]:
    """All that can touch and move."""
    geoms = read_geoms(model)
    pairs = [pair for pair in read_pairs(model) if geoms[pair.one].body or geoms[pair.other].body]
    return tuple(
        Contact(
            one=geoms[pair.one],
            other=other,
            parameters=pair.parameters,
            inverse_weight=float(model.body_invweight0[model.geom_bodyid[[pair.one, pair.other]], 0].sum()),
            is_elliptic=model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC,
            impratio=float(model.opt.impratio),
        )
        for pair, other in merged(pairs, geoms)
    )


def contact_rows(tree: Tree, contact: Contact, at: Poses, moving: Motion, qvel: Vector) -> list[Group]:
    """A group for each point of the contact."""
    one = placed(contact.one, at)
    other = (
        chosen(contact.other, one.position)
        if isinstance(contact.other, Choice)
        else placed(contact.other, at)
    )
    collide, _ = COLLIDERS[contact.kinds]
    return [_group(tree, contact, touch, moving, qvel) for touch in collide(one, other)]


def _group(tree: Tree, contact: Contact, touch: Touch, moving: Motion, qvel: Vector) -> Group:
    parameters, distance = contact.parameters, touch.distance - contact.parameters.margin
    directions = _directions(tree, contact, touch, moving)
    speeds = [total(entry * qvel[i] for i, entry in one.items()) for one in directions]
    impedance = impedance_at(parameters.softness.impedance, distance)
    damping = parameters.friction_damping if contact.is_elliptic else parameters.softness.damping
    normal = reference_at(parameters.softness, impedance, distance, speeds[0])
    return Group(
        directions, [normal, *(-damping * speed for speed in speeds[1:])], _law(contact, impedance, distance)
    )


def _law(contact: Contact, impedance: Number, distance: Number) -> Law:
    friction, weight = contact.parameters.friction, contact.inverse_weight
    if not friction:
        return OneSided(stiffness_at(impedance, weight, distance))
    # Of the cone that is regularised by `impratio`.
    slope = friction[0] / contact.impratio**0.5
    if contact.is_elliptic:
        return Cone(stiffness_at(impedance, weight, distance), slope, friction)
    edge = weight * (1.0 + friction[0] ** 2) * 2.0 * slope**2
    return Pyramid(stiffness_at(impedance, edge, distance), friction)


def _directions(tree: Tree, contact: Contact, touch: Touch, moving: Motion) -> list[Direction]:
    """The normal, and as many of both tangents, turning about the normal and rolling as there is friction."""
    num = 1 + len(contact.parameters.friction)
    frame = [touch.normal, *(_tangents(touch.normal, touch.along) if num > 1 else ())]
    slides, turns = dict[int, Vector](), dict[int, Vector]()
    bodies = contact.one.body, contact.other.body
    moves = [_moved_by(tree, body) for body in bodies]
    for body, own, others, sign in zip(bodies, moves, reversed(moves), (-1.0, 1.0), strict=True):
        for i in (i for i in own if i not in others):
            arm = subtract(touch.position, moving.centres[tree.bodies[body].root])
            turn, way = moving.axes[i][:3], moving.axes[i][3:]
            slides[i] = scale([x + y for x, y in zip(way, cross(turn, arm), strict=True)], sign)
            turns[i] = scale(turn, sign)
    along = [(axis, slides) for axis in frame] + [(axis, turns) for axis in frame]
    return [{i: dot(axis, speed) for i, speed in speeds.items()} for axis, speeds in along[:num]]


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
