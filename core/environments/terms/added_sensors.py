"""Sensors of contacts, the same on every engine, for what the terms of a task read."""

from collections.abc import Iterable

import mujoco

from core.environments.terms.readings import ContactCount, ContactForce, ContactNetForce, Reading

# m: a touch sensor sums the contacts within its site, which is a ball about all of a body's geoms.
_ABOUT_A_BODY = 10.0
# Viewers draw the groups 0 to 2.
_HIDDEN = 5


def add_sensors(spec: mujoco.MjSpec, readings: Iterable[Reading]) -> None:
    """Add a sensor for each reading, after those of the model. Unknown names fail at compilation.

    Counts are of the state that a step returns, forces those of its last physics step.
    """
    for reading in readings:
        match reading:
            case ContactCount():
                _add_count(spec, reading)
            case ContactForce():
                _add_force(spec, reading)
            case ContactNetForce():
                spec.add_sensor(
                    name=reading.sensor,
                    type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    objname=reading.body,
                    # Bit 1, "force", of all contacts together ("netforce"), along the world's axes.
                    intprm=[2, 3, 1],
                )


def _add_count(spec: mujoco.MjSpec, reading: ContactCount) -> None:
    sensor = spec.add_sensor(
        name=reading.sensor,
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=reading.geom,
        # The data to read (bit 0: "found", the number of contacts), unsorted, for one contact.
        intprm=[1, 0, 1],
    )
    if reading.against is not None:
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, reading.against


def _add_force(spec: mujoco.MjSpec, reading: ContactForce) -> None:
    spec.body(reading.body).add_site(
        name=reading.sensor,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[_ABOUT_A_BODY, 0, 0],
        group=_HIDDEN,
        rgba=[0, 0, 0, 0],
    )
    spec.add_sensor(
        name=reading.sensor,
        type=mujoco.mjtSensor.mjSENS_TOUCH,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname=reading.sensor,
    )
