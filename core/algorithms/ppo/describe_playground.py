"""Write playground.json: `python -m core.algorithms.ppo.describe_playground`."""

import json
from importlib import import_module
from importlib.metadata import version
from typing import Any

from core.algorithms.ppo.tuned import SETTINGS
from core.environments.external.playground.info import INFOS

# Our PPO has other names for these, or does without: fresh starts come from `reset_pool_size`.
_NOT_OURS = ("num_resets_per_eval",)


def settings() -> dict[str, Any]:
    """The installed package's settings for Brax's PPO: those that all share, and each environment's own."""
    found = {info.arguments["name"]: _ppo(info.arguments["name"]) for info in INFOS}
    first, *others = found.values()
    shared = {key: value for key, value in first.items() if all(one[key] == value for one in others)}
    return {
        "package": f"playground {version('playground')}",
        "shared": shared,
        "environments": {
            name: {key: value for key, value in one.items() if key not in shared}
            for name, one in found.items()
        },
    }


def _ppo(name: str) -> dict[str, Any]:
    config = import_module("mujoco_playground.config.dm_control_suite_params").brax_ppo_config(name)
    return {key: value for key, value in config.to_dict().items() if key not in _NOT_OURS}


if __name__ == "__main__":
    SETTINGS.write_text(json.dumps(settings(), indent=1) + "\n")
