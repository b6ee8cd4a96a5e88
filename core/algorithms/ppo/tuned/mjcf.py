"""PPO on a user's own model: near the humanoid's values, with smaller batches."""

from collections.abc import Mapping
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.info import Device

_CPU: Mapping[str, Any] = {
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "unroll_length": 10,
    "batch_size": 256,
    "num_minibatches": 8,
    "num_updates_per_batch": 4,
    "learning_rate": 3e-4,
    "discounting": 0.97,
    "entropy_cost": 1e-3,
    "reward_scaling": 0.1,
    "normalize_observations": True,
}
_GPU: Mapping[str, Any] = {
    **_CPU,
    "num_timesteps": 50_000_000,
    "num_evals": 3,
    "num_envs": 2048,
    "batch_size": 512,
    "num_minibatches": 32,
}
MJCF: Mapping[Device, PPOSpec] = {"cpu": PPOSpec.model_validate(_CPU), "gpu": PPOSpec.model_validate(_GPU)}
