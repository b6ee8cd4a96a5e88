"""Geoms where they are, and points where they touch."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mujoco_compiled.collisions.fields import HeightField
from mujoco_compiled.collisions.hulls import Hull
from mujoco_compiled.collisions.own_boxes import OwnBoxes, fixed_boxes, own_boxes, own_numbers
from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    add,
    dot,
    product,
    rotate,
    rotation_matrix,
    select,
    sqrt,
    transpose,
)
from mujoco_compiled.smooth.kinematics import Poses

# In m, between geoms at a point that is not there.
AWAY = 1e3


@dataclass(frozen=True)
class Geom:
    """number: MuJoCo's. body: 0 if it never moves. position [3] in m, rotation [3][3]: in the body's frame.

    size: MuJoCo's `geom_size` in m. bound: the radius of a sphere about it in m, 0 for a plane. hull,
    field: those of a mesh and of a height field that can touch.
    """

    number: int
    kind: int
    body: int
    position: Vector
    rotation: Matrix
    size: Vector
    bound: Number
    hull: Hull | None = None
    field: HeightField | None = None


@dataclass(frozen=True)
class Placed:
    """A geom in the world. to_world: the body's rotation; to_body: the geom's in its body."""

    position: Vector
    to_world: Matrix
    to_body: Matrix
    size: Vector
    hull: Hull | None = None
    field: HeightField | None = None

    @property
    def axis(self) -> Vector:
        """Its z axis, along which a capsule lies and a plane pushes."""
        return self.outward([0.0, 0.0, 1.0])

    def outward(self, vector: Vector) -> Vector:
        """A vector [3] in the geom's frame, in the world's."""
        return rotate(self.to_world, rotate(self.to_body, vector))

    def inward(self, vector: Vector) -> Vector:
        """A vector [3] in the world's frame, in the geom's."""
        return rotate(transpose(self.to_body), rotate(transpose(self.to_world), vector))


@dataclass(frozen=True)
class Touch:
    """Where two geoms touch. position: [3] in m, midway. distance: in m, below 0 where they overlap.

    normal: [3], from the first geom to the second. along: [3], the direction of the first tangent, if the
    geoms say one.
    """

    position: Vector
    distance: Number
    normal: Vector
    along: Vector | None = None


def chosen(condition: Number, one: Touch, other: Touch) -> Touch:
    """The one where the condition is true, and the other elsewhere."""
    return Touch(
        [select(condition, x, y) for x, y in zip(one.position, other.position, strict=True)],
        select(condition, one.distance, other.distance),
        [select(condition, x, y) for x, y in zip(one.normal, other.normal, strict=True)],
    )


def read_geoms(fields: Fields) -> tuple[Geom, ...]:
    """The model's geoms; boxes that never move may be where an environment has them."""
    model, own = fields.model, own_boxes(fields)
    at_rest = mujoco.MjData(model)
    mujoco.mj_kinematics(model, at_rest)
    geoms = [_geom(model, number, at_rest) for number in range(model.ngeom)]
    if own is not None:
        for number in fixed_boxes(model):
            geoms[number] = _own_box(fields, own, geoms[number], at_rest)
    return tuple(geoms)


def placed(geom: Geom, at: Poses) -> Placed:
    """The geom in this state."""
    to_world = at.rotations[geom.body]
    position = add(at.positions[geom.body], rotate(to_world, geom.position))
    return Placed(position, to_world, geom.rotation, geom.size, geom.hull, geom.field)


def _geom(model: mujoco.MjModel, number: int, at_rest: mujoco.MjData) -> Geom:
    body = int(model.geom_bodyid[number])
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[number])
    position = model.geom_pos[number]
    if model.body_treeid[body] < 0:
        body, position, rotation = 0, at_rest.geom_xpos[number], at_rest.geom_xmat[number]
    return Geom(
        number=number,
        kind=int(model.geom_type[number]),
        body=body,
        position=_rounded(position),
        rotation=[_rounded(row) for row in rotation.reshape(3, 3)],
        size=[float(x) for x in model.geom_size[number]],
        bound=float(model.geom_rbound[number]),
    )


def _own_box(fields: Fields, own: OwnBoxes, box: Geom, at_rest: mujoco.MjData) -> Geom:
    body = int(fields.model.geom_bodyid[box.number])
    to_world = [_rounded(row) for row in at_rest.xmat[body].reshape(3, 3)]
    place = own_numbers(fields, "geom_pos", box.number, own.pos)
    rotation = box.rotation
    if box.number in own.turned and "geom_quat" in fields.own:
        rotation = product(to_world, rotation_matrix(fields.row("geom_quat", box.number)))
    size = own_numbers(fields, "geom_size", box.number, own.size)
    position = add(_rounded(at_rest.xpos[body]), rotate(to_world, place))
    return replace(box, position=position, rotation=rotation, size=size, bound=sqrt(dot(size, size)))


def _rounded(values: np.ndarray) -> Vector:
    """Without the traces that rounding leaves of 0 and 1: each would be an operation at every substep."""
    nearest = np.round(values)
    return [float(x) for x in np.where(np.abs(values - nearest) < 1e-15, nearest, values)]
