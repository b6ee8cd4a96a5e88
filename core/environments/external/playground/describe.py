"""Makes the table of Playground: `python -m core.environments.external.playground.describe`."""

import json
from importlib import import_module
from importlib.metadata import version
from typing import Any

from core.environments.external.playground.environment import Playground
from core.environments.external.playground.info import TABLE

_MENAGERIE = (
    "its body is in MuJoCo Menagerie, which Playground fetches from the network when it is first loaded; "
    "workers fetch nothing. Send the body to POST /models, and use the environment 'mjcf'"
)


def table() -> dict[str, Any]:
    """Facts on each environment in the installed package's registry."""
    package = import_module("mujoco_playground")
    cannot: dict[str, list[str]] = {}
    found: dict[str, Playground] = {}
    for name in package.dm_control_suite.ALL_ENVS:
        try:
            found[name] = Playground(name, "jax")
        except Exception as error:  # a foreign package may fail with anything
            why = (
                f"playground {version('playground')} cannot load it with MuJoCo {version('mujoco')} ({error})"
            )
            cannot.setdefault(why, []).append(name)
    elsewhere = [*package.locomotion.ALL_ENVS, *package.manipulation.ALL_ENVS]
    return {
        "package": f"playground {version('playground')}",
        "environments": {name: _facts(one) for name, one in found.items()},
        "cannot": {**cannot, _MENAGERIE: elsewhere},
    }


def _facts(environment: Playground) -> dict[str, Any]:
    model = environment.model
    return {
        "observation_size": environment.observation_size,
        "action_size": environment.action_size,
        "dt": environment.dt,
        "episode_length": environment.episode_length,
        "tracked_body": model.body(environment.tracked_body).name,
        "cameras": [model.camera(number).name for number in range(model.ncam)],
    }


if __name__ == "__main__":
    TABLE.write_text(json.dumps(table(), indent=1) + "\n")
