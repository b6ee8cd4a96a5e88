"""The environments that SAC has tuned values for, on a GPU.

To add some, write {"cpu": ..., "gpu": ...} here, and its line in `TUNED`.
"""

from collections.abc import Mapping
from typing import Any

from core.algorithms.sac.spec import SACSpec
from core.environments.info import Device, EnvironmentInfo

_GPU: Mapping[str, Any] = {
    "num_evals": 2,
    "unroll_length": 4,
    "batch_size": 8192,
    "grad_updates_per_step": 4,
    "max_replay_size": 2**19,
    "learning_rate": 1e-3,
    "tau": 0.1,
    "reward_scaling": 0.1,
    "value_min": -10.0,
    "q_hidden_layer_sizes": [512, 512],
}

RODENT: Mapping[Device, SACSpec] = {
    "gpu": SACSpec.model_validate(
        {
            **_GPU,
            "num_timesteps": 8_000_000,
            "num_envs": 4096,
            "grad_updates_per_step": 8,
            "discounting": 0.98,
            "value_max": 100.0,
            "normalize_observations_max_abs_value": 10.0,
        }
    )
}
HUMANOID: Mapping[Device, SACSpec] = {
    "gpu": SACSpec.model_validate(
        {**_GPU, "num_timesteps": 5_000_000, "num_envs": 1024, "discounting": 0.97, "value_max": 50.0}
    )
}
WALKER2D: Mapping[Device, SACSpec] = {
    "gpu": SACSpec.model_validate(
        {**_GPU, "num_timesteps": 5_000_000, "num_envs": 1024, "discounting": 0.99, "value_max": 80.0}
    )
}
TUNED = {"humanoid": HUMANOID, "rodent": RODENT, "walker2d": WALKER2D}


def tuned(environment: EnvironmentInfo, device: Device) -> SACSpec:
    """The values that fit the environment on this device; all others are unset."""
    return TUNED.get(environment.id, {}).get(device, SACSpec())
