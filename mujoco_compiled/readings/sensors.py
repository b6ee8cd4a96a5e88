"""Sensors that follow from positions and velocities; contacts and forces, which `Scene.readings` has.

Source: MuJoCo's documentation, XML reference, "sensor".
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco

from mujoco_compiled.program.arithmetic import (
    Vector,
    add,
    clip,
    cross,
    minimum,
    normalized,
    quaternion_product,
    rotate,
    subtract,
    transpose,
)
from mujoco_compiled.readings.contact_sensors import KINDS as CONTACT_KINDS
from mujoco_compiled.readings.force_sensors import KINDS as FORCE_KINDS
from mujoco_compiled.readings.scene import Frame, Scene
from mujoco_compiled.smooth.actuation import actuator_stretch, transmission
from mujoco_compiled.smooth.spatial import conjugate

_Kind = mujoco.mjtSensor


@dataclass(frozen=True)
class SensorConstants:
    """number: its own. kind: of MuJoCo's `mjtSensor`. object: what it reads, of the kind `object_kind`.
    reference: the frame in which it reads; None: the world's."""

    number: int
    kind: int
    object: int
    object_kind: int
    reference: Frame | None


def sensor_values(scene: Scene) -> Vector:
    """MuJoCo's `sensordata`: the sensors' values one after the other."""
    model, found = scene.fields.model, list[Vector]()
    for number in range(model.nsensor):
        reference = int(model.sensor_refid[number])
        sensor = SensorConstants(
            number=number,
            kind=int(model.sensor_type[number]),
            object=int(model.sensor_objid[number]),
            object_kind=int(model.sensor_objtype[number]),
            reference=scene.frame(model.sensor_reftype[number], reference) if reference >= 0 else None,
        )
        values, cutoff = _READ[sensor.kind](scene, sensor), _cutoff(model, number)
        if cutoff > 0.0 and model.sensor_datatype[number] == mujoco.mjtDataType.mjDATATYPE_REAL:
            values = [clip(value, -cutoff, cutoff) for value in values]
        if cutoff > 0.0 and model.sensor_datatype[number] == mujoco.mjtDataType.mjDATATYPE_POSITIVE:
            values = [minimum(value, cutoff) for value in values]
        found.append(values)
    return [value for values in found for value in values]


def _cutoff(model: mujoco.MjModel, sensor: int) -> float:
    """The most that it reads; 0 without."""
    counts = model.sensor_type[sensor] == _Kind.mjSENS_CONTACT
    return 0.0 if counts else float(model.sensor_cutoff[sensor])


def is_known(kind: int) -> bool:
    """Whether the values of this kind of sensor can be computed."""
    return kind in _READ


def _joint(scene: Scene, sensor: SensorConstants) -> Vector:
    model, joint = scene.fields.model, sensor.object
    position, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    match sensor.kind:
        case _Kind.mjSENS_JOINTPOS:
            return [scene.qpos[position]]
        case _Kind.mjSENS_JOINTVEL:
            return [scene.qvel[dof]]
        case _Kind.mjSENS_BALLQUAT:
            return normalized(scene.qpos[position : position + 4])
        case _:
            return scene.qvel[dof : dof + 3]


def _length(scene: Scene, sensor: SensorConstants) -> Vector:
    """The length of a tendon or an actuator, or its rate."""
    if sensor.kind in (_Kind.mjSENS_TENDONPOS, _Kind.mjSENS_TENDONVEL):
        found = scene.posture.tendons[sensor.object]
    else:
        found = actuator_stretch(transmission(scene.fields, sensor.object), scene.posture)
    reads_length = sensor.kind in (_Kind.mjSENS_TENDONPOS, _Kind.mjSENS_ACTUATORPOS)
    return [found.length if reads_length else found.rate(scene.qvel)]


def _position(scene: Scene, sensor: SensorConstants) -> Vector:
    position = scene.position(scene.frame(sensor.object_kind, sensor.object))
    if sensor.reference is None:
        return position
    apart = subtract(position, scene.position(sensor.reference))
    return rotate(transpose(scene.rotation(sensor.reference)), apart)


def _axis(scene: Scene, sensor: SensorConstants) -> Vector:
    place = sensor.kind - _Kind.mjSENS_FRAMEXAXIS
    axis = transpose(scene.rotation(scene.frame(sensor.object_kind, sensor.object)))[place]
    return rotate(transpose(scene.rotation(sensor.reference)), axis) if sensor.reference else axis


def _quaternion(scene: Scene, sensor: SensorConstants) -> Vector:
    quaternion = scene.quaternion(scene.frame(sensor.object_kind, sensor.object))
    if sensor.reference is None:
        return quaternion
    return quaternion_product(conjugate(scene.quaternion(sensor.reference)), quaternion)


def _velocity(scene: Scene, sensor: SensorConstants) -> Vector:
    frame, reference = scene.frame(sensor.object_kind, sensor.object), sensor.reference
    turn, way = scene.velocity(frame)
    if reference is not None:
        own_turn, own_way = scene.velocity(reference)
        apart = subtract(scene.position(frame), scene.position(reference))
        turn, way = subtract(turn, own_turn), add(subtract(way, own_way), cross(apart, own_turn))
        back = transpose(scene.rotation(reference))
        turn, way = rotate(back, turn), rotate(back, way)
    return turn if sensor.kind == _Kind.mjSENS_FRAMEANGVEL else way


def _at_site(scene: Scene, sensor: SensorConstants) -> Vector:
    """A quantity in the axes of a site."""
    site = scene.frame(mujoco.mjtObj.mjOBJ_SITE, sensor.object)
    to_site = transpose(scene.rotation(site))
    if sensor.kind == _Kind.mjSENS_MAGNETOMETER:
        return rotate(to_site, [float(x) for x in scene.fields.model.opt.magnetic])
    turn, way = scene.velocity(site)
    return rotate(to_site, turn if sensor.kind == _Kind.mjSENS_GYRO else way)


def _subtree(scene: Scene, sensor: SensorConstants) -> Vector:
    if sensor.kind == _Kind.mjSENS_SUBTREECOM:
        return scene.means(scene.poses.centres)[sensor.object]
    frames = [scene.frame(mujoco.mjtObj.mjOBJ_BODY, body) for body in range(len(scene.tree.bodies))]
    return scene.means([scene.velocity(frame)[1] for frame in frames])[sensor.object]


def _read_before(scene: Scene, sensor: SensorConstants) -> Vector:
    return scene.readings[sensor.number]


_READ: Mapping[int, Callable[[Scene, SensorConstants], Vector]] = {
    **dict.fromkeys((_Kind.mjSENS_JOINTPOS, _Kind.mjSENS_JOINTVEL), _joint),
    **dict.fromkeys((_Kind.mjSENS_BALLQUAT, _Kind.mjSENS_BALLANGVEL), _joint),
    **dict.fromkeys((_Kind.mjSENS_TENDONPOS, _Kind.mjSENS_TENDONVEL), _length),
    **dict.fromkeys((_Kind.mjSENS_ACTUATORPOS, _Kind.mjSENS_ACTUATORVEL), _length),
    **dict.fromkeys(
        (_Kind.mjSENS_FRAMEXAXIS, _Kind.mjSENS_FRAMEYAXIS, _Kind.mjSENS_FRAMEZAXIS),
        _axis,
    ),
    _Kind.mjSENS_FRAMEPOS: _position,
    _Kind.mjSENS_FRAMEQUAT: _quaternion,
    **dict.fromkeys((_Kind.mjSENS_FRAMELINVEL, _Kind.mjSENS_FRAMEANGVEL), _velocity),
    **dict.fromkeys((_Kind.mjSENS_GYRO, _Kind.mjSENS_VELOCIMETER, _Kind.mjSENS_MAGNETOMETER), _at_site),
    **dict.fromkeys((_Kind.mjSENS_SUBTREECOM, _Kind.mjSENS_SUBTREELINVEL), _subtree),
    **dict.fromkeys((*CONTACT_KINDS, *FORCE_KINDS), _read_before),
    _Kind.mjSENS_CLOCK: lambda scene, _: [scene.time],
}
