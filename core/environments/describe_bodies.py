"""Makes the table of our environments' bodies: `python -m core.environments.describe_bodies`."""

import json
from typing import Any

import mujoco

from core.environments.bodies import TABLE
from core.environments.catalog import make, resolve
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.mjcf.model import compiled
from core.environments.robots.info import ROBOTS
from core.environments.robots.info import TABLE as ROBOTS_TABLE
from core.environments.robots.model import spec
from core.environments.terms.describe import inventory
from core.physics.choose import engine_builder

_OBSERVES_BODIES = ("humanoid", "rodent")
_PLAIN = ("ant", "half_cheetah", "hopper", "walker2d", "reacher", "inverted_pendulum", *_OBSERVES_BODIES)


def table() -> dict[str, Any]:
    """The parts of each body; the bodies' names only where an observation has rows of them."""
    found = {name: described(_model(name)) for name in _PLAIN}
    for name in set(_PLAIN) - set(_OBSERVES_BODIES):
        found[name]["bodies"] = []
    for name, walker in WALKERS.items():
        # Its environment would look for its body in the table.
        parts = described(corridor_model(CorridorOptions.model_validate({"walker": name})))
        trunk = parts["bodies"].index(walker.trunk)
        found[f"corridor/{name}"] = {**parts, "bodies": parts["bodies"][trunk : trunk + walker.num_bodies]}
    return found


def described(model: mujoco.MjModel) -> dict[str, Any]:
    """The parts of one model, as `core.environments.bodies.Body` has them."""
    parts = inventory(model)
    return {
        "joints": {joint.name: joint.type for joint in parts.joints},
        "controls": {
            actuator.name or _joint_of(model, number): actuator.control_range
            for number, actuator in enumerate(parts.actuators)
        },
        "bodies": [name for name in parts.bodies if name != "world"],
    }


def _joint_of(model: mujoco.MjModel, actuator: int) -> str:
    return str(model.joint(int(model.actuator_trnid[actuator, 0])).name)


def _model(environment: str) -> mujoco.MjModel:
    return make(*resolve(environment, {}), engine_builder("native")).model


def robots() -> dict[str, Any]:
    """The inventory of each robot's model as it is trained."""
    return {
        name: inventory(compiled(spec(robot))).model_dump(mode="json", exclude_defaults=True)
        for name, robot in ROBOTS.items()
    }


if __name__ == "__main__":
    TABLE.write_text(json.dumps(table(), indent=1) + "\n")
    ROBOTS_TABLE.write_text(json.dumps(robots(), indent=1) + "\n")
