"""Makes the table of our environments' bodies: `python -m core.environments.describe_bodies`."""

import json
from typing import Any

from core.environments.catalog import BUILT_IN
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import corridor_model
from core.environments.dm_control.corridor.walkers import WALKERS, Walker
from core.environments.page_env import parts_of
from core.environments.plugins import Plugin, bodies_of, digest_of, robot_of
from core.environments.robots.model import spec
from core.environments.task_model import compiled
from core.environments.terms.describe import inventory
from core.environments.terms.inventory import TABLE, Inventory
from core.environments.terms.task import TaskOptions
from core.physics.model import brax_model


def table() -> dict[str, Any]:
    """The inventory of each body, without what nothing of the catalog reads."""
    return {**pages(), **{f"corridor/{name}": walker(name) for name in WALKERS}}


def pages() -> dict[str, Any]:
    """Those of bodies that are pages, and the reacher's."""
    rows = [info for info in BUILT_IN.values() if "model" in info.arguments]
    models = {info.id: parts_of(info.id, info.arguments["model"], info.options()) for info in rows}
    found = {
        info.id: _as_json(models[info.id], names_geoms=issubclass(info.options, TaskOptions)) for info in rows
    }
    return {**found, "reacher": _as_json(inventory(brax_model("reacher")))}


def walker(name: Walker) -> dict[str, Any]:
    """That of a walker in a corridor, which comes after its arena."""
    parts = inventory(corridor_model(CorridorOptions.model_validate({"walker": name, "arena": "empty"})))
    carried = parts.bodies[parts.bodies.index(WALKERS[name].trunk) :]
    return _as_json(parts.model_copy(update={"bodies": carried, "geoms": []}))


def bodies_of_plugin(plugin: Plugin) -> dict[str, Any]:
    """The table that lies beside a plugin's module. Raises BadPlugin, JobFailed."""
    if plugin.module is None:
        return {}
    robots = {body.name: robot_of(plugin.name, body, plugin.module) for body in bodies_of(plugin.module)}
    return {
        name: {"of": digest_of(robot), "parts": _as_json(inventory(compiled(spec(robot))), names_geoms=True)}
        for name, robot in robots.items()
    }


def _as_json(parts: Inventory, *, names_geoms: bool = False) -> dict[str, Any]:
    """names_geoms: with the geoms that a job's own terms may name."""
    without = None if names_geoms else {"colliders", "fixed_geoms"}
    return parts.model_dump(mode="json", exclude_defaults=True, exclude=without)


if __name__ == "__main__":
    TABLE.write_text(json.dumps(table(), indent=1) + "\n")
