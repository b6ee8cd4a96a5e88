"""Makes the table of our environments' bodies: `python -m core.environments.describe_bodies`."""

import json
from typing import Any

import mujoco

from core.environments.bodies import TABLE
from core.environments.catalog import BUILT_IN, make, resolve
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.corridor.walkers import WALKERS
from core.environments.mjcf.model import compiled
from core.environments.page_env import parts_of
from core.environments.robots.info import ROBOTS
from core.environments.robots.info import TABLE as ROBOTS_TABLE
from core.environments.robots.model import spec
from core.environments.terms.describe import inventory
from core.environments.terms.inventory import Inventory
from core.environments.terms.page import TABLE as PAGES_TABLE
from core.physics.choose import engine_builder


def table() -> dict[str, Any]:
    """The parts of each body that is no page."""
    found = {"reacher": described(_model("reacher"))}
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


def pages() -> dict[str, Any]:
    """The inventory of each page's model, without what no term of a page reads."""
    rows = (info for info in BUILT_IN.values() if "model" in info.arguments)
    models = {info.id: parts_of(info.id, info.arguments["model"], info.options()) for info in rows}
    return {name: _as_json(parts, {"colliders", "fixed_geoms"}) for name, parts in models.items()}


def robots() -> dict[str, Any]:
    """The inventory of each robot's model as it is trained."""
    return {name: _as_json(inventory(compiled(spec(robot)))) for name, robot in ROBOTS.items()}


def _as_json(parts: Inventory, without: set[str] | None = None) -> dict[str, Any]:
    return parts.model_dump(mode="json", exclude_defaults=True, exclude=without)


if __name__ == "__main__":
    TABLE.write_text(json.dumps(table(), indent=1) + "\n")
    PAGES_TABLE.write_text(json.dumps(pages(), indent=1) + "\n")
    ROBOTS_TABLE.write_text(json.dumps(robots(), indent=1) + "\n")
