"""The catalog's rows of Brax's registry, from a table that `describe` makes of the package."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import Field

from core.documents import Strict
from core.environments.info import EnvironmentInfo
from core.physics.availability import EngineName

FAMILY = "brax"
TABLE = Path(__file__).parent / "table.json"
EPISODE_LENGTH = 1000

Backend = Literal["generalized", "spring", "positional", "mjx"]
BACKENDS: tuple[Backend, ...] = ("generalized", "spring", "positional", "mjx")


class BraxOptions(Strict):
    """Brax's environments with their own defaults."""

    backend: Backend = Field("generalized", description="The Brax physics pipeline that steps the body.")


# By id: our environment with the same body and the same reward.
SAME_TASK = {
    "brax/ant": "ant",
    "brax/halfcheetah": "half_cheetah",
    "brax/hopper": "hopper",
    "brax/humanoid": "humanoid",
    "brax/inverted_pendulum": "inverted_pendulum",
    "brax/reacher": "reacher",
    "brax/walker2d": "walker2d",
}


def _row(name: str, facts: Mapping[str, Any]) -> EnvironmentInfo:
    why = f"{FAMILY}/{name} has Brax's own physics: choose it by options.backend and leave `physics` out."
    cannot: dict[EngineName, str] = dict.fromkeys(get_args(EngineName), why)
    ours = SAME_TASK.get(f"{FAMILY}/{name}")
    also = f" {ours!r} is the same task on this service's engines." if ours else ""

    def vary(options: BraxOptions) -> dict[str, Any]:
        return {"dt": facts["dt"][options.backend], "own_physics": f"brax {options.backend}"}

    return EnvironmentInfo(
        id=f"{FAMILY}/{name}",
        description=f"{name} of Brax's registry, moved by Brax's own physics.{also}",
        factory="core.environments.external.brax.environment:make",
        arguments={"name": name},
        observation_size=facts["observation_size"],
        action_size=facts["action_size"],
        dt=facts["dt"]["generalized"],
        episode_length=EPISODE_LENGTH,
        tracked_body=facts["tracked_body"],
        cameras=tuple(facts["cameras"]),
        options=BraxOptions,
        cannot_run=cannot,
        own_physics="brax generalized",
        vary=vary,
    )


def _read() -> tuple[tuple[EnvironmentInfo, ...], dict[str, str]]:
    table: dict[str, Any] = json.loads(TABLE.read_text())
    rows = tuple(_row(name, facts) for name, facts in table["environments"].items())
    return rows, {f"{FAMILY}/{name}": why for name, why in table["cannot"].items()}


# INFOS: the environments that step. CANNOT: by id, why the others in the package's registry do not.
INFOS, CANNOT = _read()
