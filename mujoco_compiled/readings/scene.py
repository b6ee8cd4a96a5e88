"""A state of a model, and what follows from its positions and velocities, computed when first asked for."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from mujoco_compiled.fields import Fields, divided
from mujoco_compiled.program.arithmetic import (
    Matrix,
    Number,
    Vector,
    add,
    cross,
    product,
    quaternion_product,
    rotate,
    rotation_matrix,
    scale,
    subtract,
)
from mujoco_compiled.smooth.dynamics import Motion, motion
from mujoco_compiled.smooth.kinematics import Poses, poses
from mujoco_compiled.smooth.paths import Posture
from mujoco_compiled.smooth.tendons import read_tendons, with_tendons
from mujoco_compiled.smooth.tree import Tree, read_tree

NO_READINGS: Mapping[int, Vector] = {}


@dataclass(frozen=True)
class Frame:
    """A body's, geom's or site's own axes. position: [3] in the body's frame, in m. quaternion: [4] in it."""

    body: int
    position: Vector
    quaternion: Vector


class Scene:
    """qpos: [nq]. qvel: [nv]. time: in s. readings: by the numbers of sensors of contacts and
    forces."""

    def __init__(
        self,
        fields: Fields,
        qpos: Vector,
        qvel: Vector,
        time: Number = 0.0,
        readings: Mapping[int, Vector] = NO_READINGS,
    ) -> None:
        self.fields, self.qpos, self.qvel = fields, qpos, qvel
        self.time, self.readings = time, readings

    @cached_property
    def tree(self) -> Tree:
        return read_tree(self.fields.model, self.fields.own)

    @cached_property
    def posture(self) -> Posture:
        tendons = read_tendons(self.fields.model, self.fields.own)
        return with_tendons(Posture(self.tree, self.poses, self.motion, self.qpos), tendons)

    @cached_property
    def poses(self) -> Poses:
        return poses(self.tree, self.qpos)

    @cached_property
    def motion(self) -> Motion:
        return motion(self.tree, self.poses, self.qvel)

    def means(self, values: list[Vector]) -> list[Vector]:
        """By body: the mean over itself and all that it carries, by mass, of vectors by body."""
        bodies = self.tree.bodies
        moments = [scale(value, body.mass) for value, body in zip(values, bodies, strict=True)]
        masses = [body.mass for body in bodies]
        for number in range(len(bodies) - 1, 0, -1):
            above = bodies[number].parent
            moments[above] = add(moments[above], moments[number])
            masses[above] = masses[above] + masses[number]
        return [
            [divided(x, mass, own) for x, own in zip(moment, value, strict=True)]
            for value, moment, mass in zip(values, moments, masses, strict=True)
        ]

    def frame(self, kind: int, number: int) -> Frame:
        """The frame of an object of MuJoCo's kind `mjtObj`."""
        model, objects = self.fields.model, mujoco.mjtObj
        match kind:
            case objects.mjOBJ_XBODY:
                return Frame(number, [0.0] * 3, [1.0, 0.0, 0.0, 0.0])
            case objects.mjOBJ_BODY:
                return _frame(number, self.fields.row("body_ipos", number), model.body_iquat[number])
            case objects.mjOBJ_GEOM:
                return _frame(model.geom_bodyid[number], model.geom_pos[number], model.geom_quat[number])
            case _:
                return _frame(model.site_bodyid[number], model.site_pos[number], model.site_quat[number])

    def position(self, frame: Frame) -> Vector:
        """[3] in the world, in m."""
        rotation = self.poses.rotations[frame.body]
        return add(self.poses.positions[frame.body], rotate(rotation, frame.position))

    def rotation(self, frame: Frame) -> Matrix:
        """[3][3], to the world."""
        return product(self.poses.rotations[frame.body], rotation_matrix(frame.quaternion))

    def quaternion(self, frame: Frame) -> Vector:
        """[4], to the world."""
        return quaternion_product(self.poses.quaternions[frame.body], frame.quaternion)

    def velocity(self, frame: Frame) -> tuple[Vector, Vector]:
        """Angular and linear velocity of the frame's origin in the world, [3] each, in rad/s and m/s."""
        if frame.body == 0:
            return [0.0] * 3, [0.0] * 3
        turn, way = self.motion.velocities[frame.body][:3], self.motion.velocities[frame.body][3:]
        centre = self.motion.centres[self.tree.bodies[frame.body].root]
        return turn, add(way, cross(turn, subtract(self.position(frame), centre)))


def _frame(body: int, position: Vector | np.ndarray, quaternion: np.ndarray) -> Frame:
    return Frame(int(body), list(position), [float(x) for x in quaternion])
