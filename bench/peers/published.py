"""The settings that Brax published for its PPO: its training notebook's.

The notebook trains the hopper and the walker by SAC; theirs are this project's own.
"""

from typing import Any

# A setting that the notebook leaves out has Brax's default.
_SHARED: dict[str, Any] = {
    "num_envs": 2048,
    "unroll_length": 20,
    "batch_size": 1024,
    "num_minibatches": 32,
    "num_updates_per_batch": 4,
    "learning_rate": 3e-4,
    "learning_rate_schedule": "NONE",
    "entropy_cost": 1e-3,
    "gae_lambda": 0.95,
    "clipping_epsilon": 0.3,
    "normalize_observations": True,
    "policy_hidden_layer_sizes": [32] * 4,
    "value_hidden_layer_sizes": [256] * 5,
    "activation": "swish",
}
_LEGS = {"discounting": 0.99, "reward_scaling": 1.0}

PUBLISHED: dict[str, dict[str, Any]] = {
    "ant": {
        **_SHARED,
        "num_envs": 4096,
        "unroll_length": 5,
        "batch_size": 2048,
        "discounting": 0.97,
        "entropy_cost": 1e-2,
        "reward_scaling": 10.0,
    },
    "humanoid": {
        **_SHARED,
        "unroll_length": 10,
        "num_updates_per_batch": 8,
        "discounting": 0.97,
        "reward_scaling": 0.1,
    },
    "half_cheetah": {
        **_SHARED,
        "batch_size": 512,
        "num_updates_per_batch": 8,
        "discounting": 0.95,
        "reward_scaling": 1.0,
    },
    "hopper": {**_SHARED, **_LEGS},
    "walker2d": {**_SHARED, **_LEGS},
}
