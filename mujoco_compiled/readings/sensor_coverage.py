"""Which sensors the stages cannot read, found before any code is made."""

from collections.abc import Iterator

import mujoco
import numpy as np

from mujoco_compiled.constraints.pairs import read_pairs
from mujoco_compiled.fields import Fields
from mujoco_compiled.named import named, word
from mujoco_compiled.readings.contact_sensors import encloses
from mujoco_compiled.readings.sensors import is_known


def unread_sensors(model: mujoco.MjModel) -> Iterator[tuple[int, str]]:
    """The sensors that cannot be read, by number, and why: the first in the model first."""
    kinds, camera, disable = mujoco.mjtSensor, mujoco.mjtObj.mjOBJ_CAMERA, mujoco.mjtDisableBit
    disables = model.opt.disableflags & (disable.mjDSBL_SENSOR | disable.mjDSBL_ACTUATION)
    for number, kind in enumerate(model.sensor_type):
        name = f"sensordata: its sensor {named(model, 'sensor', number)}"
        if disables:
            yield number, "sensordata: it disables sensors or actuators"
        elif not is_known(int(kind)):
            yield number, f"{name} is of the kind {word(kinds(int(kind)).name)}"
        elif reason := _unread_contacts(model, number):
            yield number, f"{name} {reason}"
        elif (model.sensor_objtype[number] == camera) or (model.sensor_reftype[number] == camera):
            yield number, f"{name} is about a camera"
        elif model.sensor_delay[number] or model.sensor_interval[number].any():
            yield number, f"{name} is read late or at intervals"
        elif np.isin(kind, (kinds.mjSENS_ACTUATORPOS, kinds.mjSENS_ACTUATORVEL)) and _sticks(model, number):
            yield number, f"{name} is the length or the rate of an actuator on a body"
        elif kind == kinds.mjSENS_ACTUATORPOS and not is_on_scalar(model, int(model.sensor_objid[number])):
            yield number, f"{name} is the length of an actuator on a joint with several axes"


def _unread_contacts(model: mujoco.MjModel, sensor: int) -> str | None:
    """Why a sensor of contacts cannot be read."""
    number, kind = int(model.sensor_objid[sensor]), model.sensor_type[sensor]
    if kind == mujoco.mjtSensor.mjSENS_TOUCH:
        return _unread_touch(model, number)
    if kind != mujoco.mjtSensor.mjSENS_CONTACT:
        return None
    geom, anything = int(mujoco.mjtObj.mjOBJ_GEOM), int(mujoco.mjtObj.mjOBJ_UNKNOWN)
    about, against = int(model.sensor_objtype[sensor]), int(model.sensor_reftype[sensor])
    if about != geom or against not in (geom, anything):
        return "is about contacts of other things than geoms"
    if list(model.sensor_intprm[sensor, :2]) != [1, 0] or model.sensor_dim[sensor] != 1:
        return "reads other data of contacts than their number"
    return None


def _unread_touch(model: mujoco.MjModel, site: int) -> str | None:
    """Why a touch sensor cannot be read: it reads only all contacts of a body."""
    body = int(model.site_bodyid[site])
    if model.body_treeid[body] < 0:
        return "is on a body that never moves"
    for pair in read_pairs(Fields(model)):
        for geom in (pair.one, pair.other):
            mine = model.geom_bodyid[geom] == body
            if mine and not encloses(model, site, geom, max(0.0, pair.parameters.margin)):
                return f"is not about all of the body's geom {named(model, 'geom', geom)}"
    return None


def _sticks(model: mujoco.MjModel, sensor: int) -> bool:
    """Whether a sensor is about an actuator that pulls along a body's contacts."""
    return bool(model.actuator_trntype[model.sensor_objid[sensor]] == mujoco.mjtTrn.mjTRN_BODY)


def turn_several_axes(model: mujoco.MjModel) -> np.ndarray:
    """[nactuator]: whether an actuator acts on a ball joint or a free one."""
    return np.array([not is_on_scalar(model, number) for number in range(model.nactuator)], bool)


def is_on_scalar(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator acts on a hinge, a slide or a tendon."""
    joints = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    if not np.isin(model.actuator_trntype[actuator], joints):
        return True
    return np.count_nonzero(model.dof_jntid == model.actuator_trnid[actuator, 0]) == 1
