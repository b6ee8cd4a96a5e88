"""The catalog's rows of MuJoCo Playground's environments, from a table that `describe` makes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from core.environments.info import EnvironmentInfo
from core.physics.availability import EngineName

FAMILY = "playground"
TABLE = Path(__file__).parent / "table.json"

_WHY = "MuJoCo Playground's environments step MJX themselves: choose mjx or warp, or omit `physics`."
_STEPS_ITSELF: dict[EngineName, str] = {"native": _WHY, "compiled": _WHY}


def _row(name: str, facts: Mapping[str, Any]) -> EnvironmentInfo:
    return EnvironmentInfo(
        id=f"{FAMILY}/{name}",
        description=f"{name} of MuJoCo Playground (DeepMind Control Suite), as in its package.",
        factory="core.environments.external.playground.environment:make",
        package="mujoco_playground",
        arguments={"name": name},
        observation_size=facts["observation_size"],
        action_size=facts["action_size"],
        dt=facts["dt"],
        episode_length=facts["episode_length"],
        tracked_body=facts["tracked_body"],
        cameras=tuple(facts["cameras"]),
        cannot_run=_STEPS_ITSELF,
    )


def _read() -> tuple[tuple[EnvironmentInfo, ...], dict[str, str]]:
    table: dict[str, Any] = json.loads(TABLE.read_text())
    rows = tuple(_row(name, facts) for name, facts in table["environments"].items())
    cannot = {f"{FAMILY}/{name}": why for why, names in table["cannot"].items() for name in names}
    return rows, cannot


# INFOS: the environments that can be loaded. CANNOT: by id, why the others in the package's registry cannot.
INFOS, CANNOT = _read()
