"""Sensors of contacts: touch sensors sum normal forces of the last substep, contact sensors count the points
of the state that is returned.

Source: MuJoCo's documentation, XML reference, "sensor/touch", "sensor/contact".
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mujoco_compiled.constraints.contacts import ContactPair
from mujoco_compiled.constraints.rows import ConstraintRows, by_group, residual
from mujoco_compiled.program.arithmetic import Number, Vector, maximum, select, total

_TOUCH, _CONTACT = mujoco.mjtSensor.mjSENS_TOUCH, mujoco.mjtSensor.mjSENS_CONTACT
KINDS = (int(_TOUCH), int(_CONTACT))


@dataclass(frozen=True)
class ContactSensor:
    """number: of the sensor. contacts: places of those that it reads. counts: whether it counts their points,
    or sums their normal forces in N."""

    number: int
    contacts: tuple[int, ...]
    counts: bool


def read_contact_sensors(model: mujoco.MjModel, contacts: Sequence[ContactPair]) -> tuple[ContactSensor, ...]:
    """The model's touch and contact sensors, which `coverage` must have let pass."""
    numbers = [number for number in range(model.nsensor) if int(model.sensor_type[number]) in KINDS]
    return tuple(
        ContactSensor(
            number=number,
            contacts=tuple(place for place, one in enumerate(contacts) if _reads(model, number, one)),
            counts=int(model.sensor_type[number]) == _CONTACT,
        )
        for number in numbers
    )


def normal_forces(
    sensors: Sequence[ContactSensor],
    contacts: Sequence[ContactPair],
    rows: ConstraintRows,
    acceleration: Vector,
) -> Vector:
    """By sensor that sums them, under this acceleration [nv]. rows: those of the contacts last."""
    if rows.slots:
        return rows.slots.normal_forces(acceleration, [sensor.contacts for sensor in sensors])
    first = len(rows.groups) - len(rows.distances)
    places = _places(contacts)
    pushing = {place for one in sensors for i in one.contacts for place in places[i]}
    kept = replace(rows, groups=[rows.groups[first + place] for place in sorted(pushing)])
    groups = by_group(kept, residual(kept, acceleration))
    pushes = {
        place: group.law.forces(own)[0] for place, (group, own) in zip(sorted(pushing), groups, strict=True)
    }

    return [
        total(maximum(pushes[place], 0.0) for i in sensor.contacts for place in places[i])
        for sensor in sensors
    ]


def numbers_touching(
    sensors: Sequence[ContactSensor], contacts: Sequence[ContactPair], rows: ConstraintRows
) -> Vector:
    """By sensor that counts: at how many points the geoms touch."""
    if rows.slots:
        return rows.slots.numbers_touching([sensor.contacts for sensor in sensors])
    places, distances = _places(contacts), rows.distances

    def number(sensor: ContactSensor) -> Number:
        near = ((contacts[i].parameters.reach, place) for i in sensor.contacts for place in places[i])
        return total(select(distances[place] < reach, 1.0, 0.0) for reach, place in near)

    return [number(sensor) for sensor in sensors]


def encloses(model: mujoco.MjModel, site: int, geom: int, margin: float) -> bool:
    """Whether a site is about a geom of its body, and about all contacts of it that are nearer than a margin.

    Only then does a touch sensor there read all contacts of the geom.
    """
    inner, radius = _rod(model.site_type[site], model.site_size[site])
    outer, bound = _rod(model.geom_type[geom], model.geom_size[geom], float(model.geom_rbound[geom]))
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
        return False
    axis, middle = _axis(model.site_quat[site]), model.site_pos[site]
    along = outer * _axis(model.geom_quat[geom])
    # Both are convex, so that only the ends matter.
    for end in (model.geom_pos[geom] - middle + along, model.geom_pos[geom] - middle - along):
        nearest = np.clip(end @ axis, -inner, inner) * axis
        if np.linalg.norm(end - nearest) + bound + 0.5 * margin > radius:
            return False
    return True


def _rod(kind: int, size: np.ndarray, bound: float | None = None) -> tuple[float, float]:
    """Half the length and the radius of a capsule: the shape itself, or one inside; bound: a ball around."""
    kinds = mujoco.mjtGeom
    match kind:
        case kinds.mjGEOM_CAPSULE:
            return float(size[1]), float(size[0])
        case kinds.mjGEOM_SPHERE:
            return 0.0, float(size[0])
        case _ if bound is not None:
            return 0.0, bound
        case kinds.mjGEOM_CYLINDER:
            return 0.0, float(size[:2].min())
        case _:
            return 0.0, float(size.min())


def _axis(quaternion: np.ndarray) -> np.ndarray:
    axis = np.zeros(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), quaternion)
    return axis


def _reads(model: mujoco.MjModel, sensor: int, contact: ContactPair) -> bool:
    number, other = int(model.sensor_objid[sensor]), int(model.sensor_refid[sensor])
    geoms = [contact.one.number, contact.other.number]
    if model.sensor_type[sensor] == _TOUCH:
        return bool((model.geom_bodyid[geoms] == model.site_bodyid[number]).any())
    return number in geoms and (other < 0 or (other in geoms and other != number))


def _places(contacts: Sequence[ContactPair]) -> list[range]:
    """By contact: the places of its points."""
    ends = np.cumsum([contact.num_points for contact in contacts])
    return [range(end - one.num_points, end) for one, end in zip(contacts, ends.tolist(), strict=True)]
