"""The catalog's rows of MuJoCo Playground's environments, from a table that `describe` makes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from core.environments.info import Device, EnvironmentInfo
from core.physics.availability import EngineName

FAMILY = "playground"
TABLE = Path(__file__).parent / "table.json"

_STEPS_ITSELF: dict[EngineName, str] = {
    "native": "MuJoCo Playground's environments step MJX themselves: choose mjx or warp, or omit `physics`."
}
# Playground tunes for 2048 environments on a GPU. On a CPU, MJX finishes this budget in an hour or two; an
# update has as many actions per environment, and as many gradient steps, as on the GPU.
_ON_A_CPU = {"num_timesteps": 3_000_000, "num_envs": 256, "batch_size": 128, "reset_pool_size": 32}


def _row(name: str, facts: Mapping[str, Any], shared: Mapping[str, Any]) -> EnvironmentInfo:
    ppo = {**shared, **facts["ppo"]}
    tuned: dict[Device, dict[str, Any]] = {"cpu": {**ppo, **_ON_A_CPU}, "gpu": ppo}
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
        tuned={"ppo": tuned},
        cannot_run=_STEPS_ITSELF,
    )


def _read() -> tuple[tuple[EnvironmentInfo, ...], dict[str, str]]:
    table: dict[str, Any] = json.loads(TABLE.read_text())
    rows = tuple(_row(name, facts, table["ppo"]) for name, facts in table["environments"].items())
    cannot = {f"{FAMILY}/{name}": why for why, names in table["cannot"].items() for name in names}
    return rows, cannot


# INFOS: the environments that can be loaded. CANNOT: by id, why the others in the package's registry cannot.
INFOS, CANNOT = _read()
