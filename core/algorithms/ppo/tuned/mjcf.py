"""PPO on a user's own model.

On a CPU it has the ant's values, which made bodies that nobody had tuned for run three to five times sooner
(docs/experiments/cpu_training.md). On a GPU it is near the humanoid's, with smaller batches.
"""

from collections.abc import Mapping
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.info import Device

_COMMON: Mapping[str, Any] = {
    "unroll_length": 10,
    "num_updates_per_batch": 4,
    "discounting": 0.97,
    "reward_scaling": 0.1,
    "normalize_observations": True,
}
_CPU: Mapping[str, Any] = {
    **_COMMON,
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "batch_size": 64,
    "num_minibatches": 8,
    "learning_rate": 1e-3,
    "entropy_cost": 1e-2,
    "clipping_epsilon": 0.2,
    "value_hidden_layer_sizes": [64, 64],
    "activation": "tanh",
}
_GPU: Mapping[str, Any] = {
    **_COMMON,
    "num_timesteps": 50_000_000,
    "num_evals": 3,
    "num_envs": 2048,
    "batch_size": 512,
    "num_minibatches": 32,
    "learning_rate": 3e-4,
    "entropy_cost": 1e-3,
}
MJCF: Mapping[Device, PPOSpec] = {"cpu": PPOSpec.model_validate(_CPU), "gpu": PPOSpec.model_validate(_GPU)}
