"""Sensors that count the contacts of geoms, the same on every engine."""

import mujoco

_PREFIX = "gaitway:touches:"


def sensor_name(geom: str, against: str | None) -> str:
    """The name of the sensor that counts a geom's contacts, with one other geom or with any."""
    return f"{_PREFIX}{geom}" if against is None else f"{_PREFIX}{geom}:{against}"


def is_ours(sensor: str) -> bool:
    """Whether we added the sensor."""
    return sensor.startswith(_PREFIX)


def add_sensors(spec: mujoco.MjSpec, contacts: list[tuple[str, str | None]]) -> None:
    """Add a sensor for each (geom, the one it must touch), after those of the model.

    They read the contacts of the last physics step. Unknown names fail at compilation.
    """
    for geom, against in contacts:
        sensor = spec.add_sensor(
            name=sensor_name(geom, against),
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=geom,
            # The data to read (bit 0: "found", the number of contacts), unsorted, for one contact.
            intprm=[1, 0, 1],
        )
        if against is not None:
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, against
