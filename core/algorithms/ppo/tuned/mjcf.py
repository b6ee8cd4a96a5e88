"""PPO on a user's own model: once the ant's values, with which bodies that nobody had tuned for ran sooner.

On a CPU three to five times sooner (docs/experiments/cpu_training.md), on a GPU the tutorial's quadruped
after half of the steps (docs/experiments/gpu_tuning.md).
"""

from collections.abc import Mapping
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.info import Device

_COMMON: Mapping[str, Any] = {
    "num_minibatches": 8,
    "num_updates_per_batch": 4,
    "learning_rate": 1e-3,
    "entropy_cost": 1e-2,
    "discounting": 0.97,
    "reward_scaling": 0.1,
    "clipping_epsilon": 0.2,
    "normalize_observations": True,
    "value_hidden_layer_sizes": [64, 64],
    "activation": "tanh",
}
_CPU: Mapping[str, Any] = {
    **_COMMON,
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "unroll_length": 10,
    "batch_size": 64,
}
_GPU: Mapping[str, Any] = {
    **_COMMON,
    "num_timesteps": 50_000_000,
    "num_evals": 3,
    "num_envs": 2048,
    "unroll_length": 5,
    "batch_size": 1024,
}
MJCF: Mapping[Device, PPOSpec] = {"cpu": PPOSpec.model_validate(_CPU), "gpu": PPOSpec.model_validate(_GPU)}
