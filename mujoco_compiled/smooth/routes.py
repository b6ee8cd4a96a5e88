"""Spatial tendons: strings through sites and round geoms, whose moment arms change with the state.

Source: MuJoCo's documentation, Modeling, "Tendon", and XML reference, "tendon/spatial".
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import (
    Number,
    Vector,
    add,
    cross,
    dot,
    maximum,
    product,
    rotate,
    rotation_matrix,
    scale,
    select,
    sqrt,
    subtract,
    total,
    transpose,
)
from mujoco_compiled.smooth.dynamics import accelerations
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.paths import Posture, Stretch, lever_arms, moved_alone, wrench
from mujoco_compiled.smooth.wrapping import Obstacle, wrap

_SMALLEST = 1e-30


@dataclass(frozen=True)
class Point:
    """A place on a body. position: [3] in the body's frame, in m."""

    body: int
    position: Vector


@dataclass(frozen=True)
class Piece:
    """A string between two sites. share: how much it counts of the tendon's length, less than 1 after a
    pulley."""

    start: Point
    end: Point
    around: Obstacle | None
    share: float


@dataclass(frozen=True)
class Route:
    """pulled: see `moved_alone`."""

    pieces: tuple[Piece, ...]
    pulled: Mapping[int, tuple[int, ...]]

    @property
    def dofs(self) -> Collection[int]:
        """The degrees of freedom that change the length."""
        return self.pulled


def read_route(fields: Fields, tendon: int) -> Route:
    """The route of a spatial tendon."""
    pieces = tuple(_pieces(fields, tendon))
    return Route(pieces, moved_alone(fields.model, (body for piece in pieces for body in _bodies(piece))))


def route_stretch(route: Route, posture: Posture) -> Stretch:
    """The length, and its moment arms, from the forces of a tension of -1 N on the bodies."""
    at, lengths, wrenches = posture.at, list[Number](), list[tuple[int, Vector]]()

    def pull(body: int, place: Vector, force: Vector) -> None:
        wrenches.append((body, wrench(posture, body, place, force, [0.0] * 3)))

    for piece in route.pieces:
        start, end = _place(at, piece.start), _place(at, piece.end)
        if piece.around is None:
            way = subtract(end, start)
            length = _length(way)
            along = scale(way, piece.share / length)
            pull(piece.start.body, start, scale(along, -1.0))
            pull(piece.end.body, end, along)
            lengths.append(piece.share * length)
            continue
        around, body = piece.around, piece.around.body
        frame = product(at.rotations[body], around.rotation)
        centre = add(at.positions[body], rotate(at.rotations[body], around.position))
        into = transpose(frame)
        found = wrap(around, rotate(into, subtract(start, centre)), rotate(into, subtract(end, centre)))
        first, last = (add(centre, rotate(frame, place)) for place in (found.first, found.last))
        before = subtract(_chosen(found.touches, first, end), start)
        after = subtract(end, _chosen(found.touches, last, start))
        lengths.append(
            piece.share * (_length(before) + select(found.touches, found.length + _length(after), 0.0))
        )
        onward, away = (scale(way, piece.share / _length(way)) for way in (before, after))
        pull(piece.start.body, start, scale(onward, -1.0))
        pull(piece.end.body, end, away)
        still = [0.0] * 3
        pull(body, first, _chosen(found.touches, onward, still))
        pull(body, last, _chosen(found.touches, scale(away, -1.0), still))
    return Stretch(total(lengths), lever_arms(route.pulled, posture, wrenches))


def route_drift(route: Route, posture: Posture, qvel: Vector) -> Number:
    """How the length's rate changes where no degree of freedom accelerates, in m/s²; of a route through sites
    alone."""
    still: Vector = [0.0] * len(qvel)
    of_bodies = accelerations(posture.tree, posture.moving, qvel, still, [0.0] * 3)
    terms = list[Number]()
    for piece in route.pieces:
        if piece.start.body == piece.end.body:
            continue
        ends = [_moving(posture, point, of_bodies) for point in (piece.start, piece.end)]
        place, velocity, acceleration = (subtract(last, first) for first, last in zip(*ends, strict=True))
        length = _length(place)
        along = scale(place, 1.0 / length)
        aside = subtract(velocity, scale(along, dot(along, velocity)))
        terms.append(piece.share * (dot(along, acceleration) + dot(aside, aside) / length))
    return total(terms)


def _moving(posture: Posture, point: Point, of_bodies: list[Vector]) -> tuple[Vector, Vector, Vector]:
    """A point's place, velocity and acceleration in the world, each [3]. of_bodies: see `accelerations`."""
    place, still = _place(posture.at, point), [0.0] * 3
    if not point.body:
        return place, still, still
    moving = posture.moving
    arm = subtract(place, moving.centres[posture.tree.bodies[point.body].root])
    turn, way = moving.velocities[point.body][:3], moving.velocities[point.body][3:]
    turning, speeding = of_bodies[point.body][:3], of_bodies[point.body][3:]
    velocity = add(way, cross(turn, arm))
    # A spatial acceleration is that of what passes through a place; this is that of the body itself.
    return place, velocity, add(add(speeding, cross(turning, arm)), cross(turn, velocity))


def _pieces(fields: Fields, tendon: int) -> Iterator[Piece]:
    model, kinds = fields.model, mujoco.mjtWrap
    share, start, around = 1.0, None, None
    first = int(model.tendon_adr[tendon])
    for place in range(first, first + int(model.tendon_num[tendon])):
        number = int(model.wrap_objid[place])
        match model.wrap_type[place]:
            case kinds.mjWRAP_PULLEY:
                share, start, around = 1.0 / float(model.wrap_prm[place]), None, None
            case kinds.mjWRAP_SITE:
                end = Point(int(model.site_bodyid[number]), _floats(model.site_pos[number]))
                if start is not None:
                    yield Piece(start, end, around, share)
                start, around = end, None
            case _:
                around = _obstacle(fields, number, int(model.wrap_prm[place]))


def _obstacle(fields: Fields, geom: int, side: int) -> Obstacle:
    """side: the number of a site on the geom's body; -1 for none."""
    model = fields.model
    position, radius = fields.row("geom_pos", geom), fields.row("geom_size", geom)[0]
    rotation = rotation_matrix(fields.row("geom_quat", geom))
    place = None
    if side >= 0:
        place = rotate(transpose(rotation), subtract(_floats(model.site_pos[side]), position))
    return Obstacle(
        body=int(model.geom_bodyid[geom]),
        position=position,
        rotation=rotation,
        radius=radius,
        is_cylinder=model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER,
        side=place,
        is_ring=side >= 0 and is_inside(model, geom, side),
    )


def sides(model: mujoco.MjModel) -> Iterator[tuple[int, int]]:
    """The geoms round which tendons wrap with a side site, and that site."""
    kinds = mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER
    for place in np.flatnonzero(np.isin(model.wrap_type, kinds)):
        if model.wrap_prm[place] >= 0:
            yield int(model.wrap_objid[place]), int(model.wrap_prm[place])


def is_inside(model: mujoco.MjModel, geom: int, side: int) -> bool:
    """Whether a site on a geom's body is nearer to the geom's centre than its radius."""
    apart = model.site_pos[side] - model.geom_pos[geom]
    return bool(apart @ apart < model.geom_size[geom, 0] ** 2)


def _bodies(piece: Piece) -> Iterator[int]:
    yield piece.start.body
    yield piece.end.body
    if piece.around is not None:
        yield piece.around.body


def _place(at: Poses, point: Point) -> Vector:
    """[3] in the world."""
    return add(at.positions[point.body], rotate(at.rotations[point.body], point.position))


def _chosen(condition: Number, chosen: Vector, otherwise: Vector) -> Vector:
    return [select(condition, x, y) for x, y in zip(chosen, otherwise, strict=True)]


def _length(vector: Vector) -> Number:
    return sqrt(maximum(dot(vector, vector), _SMALLEST))


def _floats(values: Iterable[float]) -> Vector:
    return [float(x) for x in values]
