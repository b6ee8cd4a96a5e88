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
# Settings that our PPO names differently or lacks: fresh starts come from `reset_pool_size`.
_NOT_OURS = ("num_resets_per_eval",)


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
    settings = {name: ppo(name) for name in found}
    first, *others = settings.values()
    shared = {key: value for key, value in first.items() if all(one[key] == value for one in others)}
    return {
        "package": f"playground {version('playground')}",
        "ppo": shared,
        "environments": {
            name: {**_facts(one), "ppo": {k: v for k, v in settings[name].items() if k not in shared}}
            for name, one in found.items()
        },
        "cannot": {**cannot, _MENAGERIE: elsewhere},
    }


def ppo(name: str) -> dict[str, Any]:
    """Playground's own settings for Brax's PPO."""
    settings = import_module("mujoco_playground.config.dm_control_suite_params").brax_ppo_config(name)
    return {key: value for key, value in settings.to_dict().items() if key not in _NOT_OURS}


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
