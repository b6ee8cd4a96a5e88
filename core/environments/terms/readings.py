"""What terms read of contacts, for which engines share no array: a sensor is added to the model for each.

No numerical code is imported here; `added_sensors` adds them.
"""

from dataclasses import dataclass

_PREFIX = "gaitway:"


@dataclass(frozen=True)
class ContactCount:
    """The number of a geom's contacts in the state, with one other geom or, if None, with any."""

    geom: str
    against: str | None = None

    @property
    def sensor(self) -> str:
        """The name of its sensor."""
        name = f"{_PREFIX}touches:{self.geom}"
        return name if self.against is None else f"{name}:{self.against}"


@dataclass(frozen=True)
class ContactForce:
    """The sum of the normal forces on a body's own geoms in the last physics step, in N."""

    body: str

    @property
    def sensor(self) -> str:
        """The name of its sensor, and of the site about the body."""
        return f"{_PREFIX}force:{self.body}"


@dataclass(frozen=True)
class ContactNetForce:
    """The sum of the forces on a body's own geoms in the last physics step, along the world's axes, [3] in N:
    up to their sign."""

    body: str

    @property
    def sensor(self) -> str:
        """The name of its sensor."""
        return f"{_PREFIX}net_force:{self.body}"


Reading = ContactCount | ContactForce | ContactNetForce


def is_added(sensor: str) -> bool:
    """Whether a sensor of this name is not the model's own."""
    return sensor.startswith(_PREFIX)
