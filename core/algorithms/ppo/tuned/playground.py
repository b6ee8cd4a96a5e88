"""PPO on MuJoCo Playground's environments: Playground's own settings, as playground.json has them.

`python -m core.algorithms.ppo.tuned.describe_playground` writes that file.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.info import Device

SETTINGS = Path(__file__).parent / "playground.json"

# Playground tunes for 2048 environments on a GPU. On a CPU, MJX finishes this budget in an hour or two; an
# update has as many actions per environment, and as many gradient steps, as on the GPU.
_ON_A_CPU: Mapping[str, Any] = {
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "batch_size": 128,
    "reset_pool_size": 32,
}


def _read() -> dict[str, Mapping[Device, PPOSpec]]:
    found: dict[str, Mapping[Device, PPOSpec]] = {}
    settings: dict[str, Any] = json.loads(SETTINGS.read_text())
    for name, own in settings["environments"].items():
        ppo = {**settings["shared"], **own}
        found[f"playground/{name}"] = {
            "cpu": PPOSpec.model_validate({**ppo, **_ON_A_CPU}),
            "gpu": PPOSpec.model_validate(ppo),
        }
    return found


PLAYGROUND = _read()
