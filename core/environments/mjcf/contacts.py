"""Contacts, in the same words on every engine: as sensors that count them."""

import mujoco

_PREFIX = "gaitway:touches:"


def sensor_name(geom: str, against: str | None) -> str:
    """Of the sensor that counts a geom's contacts, with one other geom or with any."""
    return f"{_PREFIX}{geom}" if against is None else f"{_PREFIX}{geom}:{against}"


def is_ours(sensor: str) -> bool:
    """Whether a sensor was added by us."""
    return sensor.startswith(_PREFIX)


def add_sensors(spec: mujoco.MjSpec, contacts: list[tuple[str, str | None]]) -> None:
    """A sensor for each (geom, the one it is to touch), behind those that the model has.

    They read what the last physics step found. Names that are not there fail at compilation.
    """
    for geom, against in contacts:
        sensor = spec.add_sensor(
            name=sensor_name(geom, against),
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=geom,
            # Which of the contact's numbers (a bit: "found", how many there are), unsorted, of one contact.
            intprm=[1, 0, 1],
        )
        if against is not None:
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, against
