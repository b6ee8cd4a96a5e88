"""Sensors of accelerations and of actuators' forces, which are those of the last substep.

Source: MuJoCo's documentation, XML reference, "sensor/accelerometer" and the kinds below.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from mujoco_compiled.fields import Fields
from mujoco_compiled.program.arithmetic import (
    Vector,
    add,
    cross,
    product,
    rotate,
    rotation_matrix,
    scale,
    subtract,
    transpose,
)
from mujoco_compiled.readings.scene import Frame, Scene
from mujoco_compiled.smooth.actuation import Driven
from mujoco_compiled.smooth.dynamics import Motion, accelerations
from mujoco_compiled.smooth.kinematics import Poses
from mujoco_compiled.smooth.paths import Stretch
from mujoco_compiled.smooth.tree import Tree

_Kind = mujoco.mjtSensor
_OF_FRAMES = tuple(map(int, (_Kind.mjSENS_ACCELEROMETER, _Kind.mjSENS_FRAMELINACC, _Kind.mjSENS_FRAMEANGACC)))
KINDS = (*_OF_FRAMES, int(_Kind.mjSENS_ACTUATORFRC), int(_Kind.mjSENS_JOINTACTFRC))


@dataclass(frozen=True)
class ForceSensor:
    """number: of the sensor. frame: whose acceleration it reads; part: the actuator or the degree of freedom
    whose force it reads instead."""

    number: int
    kind: int
    part: int = 0
    frame: Frame | None = None


def read_force_sensors(model: mujoco.MjModel) -> tuple[ForceSensor, ...]:
    """The model's sensors of these kinds."""
    scene = Scene(Fields(model), [], [])
    found = list[ForceSensor]()
    for number in range(model.nsensor):
        kind, place = int(model.sensor_type[number]), int(model.sensor_objid[number])
        # MuJoCo counts an accelerometer's site among the objects of no kind.
        object_kind = (
            mujoco.mjtObj.mjOBJ_SITE if kind == _Kind.mjSENS_ACCELEROMETER else model.sensor_objtype[number]
        )
        if kind in _OF_FRAMES:
            found.append(ForceSensor(number, kind, frame=scene.frame(object_kind, place)))
        elif kind == _Kind.mjSENS_JOINTACTFRC:
            found.append(ForceSensor(number, kind, part=int(model.jnt_dofadr[place])))
        elif kind == _Kind.mjSENS_ACTUATORFRC:
            found.append(ForceSensor(number, kind, part=place))
    return tuple(found)


@dataclass(frozen=True)
class Instant:
    """A substep before it moves: where the bodies are, how they move, how long the tendons are, and what the
    actuators do."""

    tree: Tree
    at: Poses
    moving: Motion
    qvel: Vector
    tendons: Sequence[Stretch]
    done: Driven


def force_readings(sensors: Sequence[ForceSensor], now: Instant, qacc: Vector) -> list[Vector]:
    """By sensor. qacc: [nv], the acceleration that the solver found."""
    found = list[Vector]()
    if any(one.frame is not None for one in sensors):
        # As if it fell without gravity.
        found = accelerations(now.tree, now.moving, now.qvel, qacc, scale(now.tree.gravity, -1.0))
    return [_reading(one, now, found) for one in sensors]


def _reading(sensor: ForceSensor, now: Instant, of_bodies: Sequence[Vector]) -> Vector:
    if sensor.frame is None:
        of = now.done.on_dofs if sensor.kind == _Kind.mjSENS_JOINTACTFRC else now.done.forces
        return [of[sensor.part]]
    body = sensor.frame.body
    if body == 0:
        turning, speeding = [0.0] * 3, scale(now.tree.gravity, -1.0)
        way, turn = [0.0] * 3, [0.0] * 3
    else:
        place = add(now.at.positions[body], rotate(now.at.rotations[body], sensor.frame.position))
        arm = subtract(place, now.moving.centres[now.tree.bodies[body].root])
        turn, turning = now.moving.velocities[body][:3], of_bodies[body][:3]
        way = add(now.moving.velocities[body][3:], cross(turn, arm))
        speeding = add(of_bodies[body][3:], cross(turning, arm))
    if sensor.kind == _Kind.mjSENS_FRAMEANGACC:
        return turning
    # A spatial acceleration is that of what passes through a place; this is that of the body itself.
    speeding = add(speeding, cross(turn, way))
    if sensor.kind == _Kind.mjSENS_FRAMELINACC:
        return speeding
    own = product(now.at.rotations[body], rotation_matrix(sensor.frame.quaternion))
    return rotate(transpose(own), speeding)
