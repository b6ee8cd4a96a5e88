"""Sweeps to begin with, in the OpenAPI document."""

from typing import Any

EXAMPLES: dict[str, Any] = {
    "a grid": {
        "value": {
            "name": "learning rates",
            "job": {"kind": "train", "environment": "ant"},
            "method": "grid",
            "parameters": {
                "seed": [1, 2],
                "algorithm.learning_rate": {"low": 1e-4, "high": 1e-3, "log": True, "points": 3},
            },
        }
    },
    "Optuna's TPE, which ends what is not promising": {
        "value": {
            "job": {
                "kind": "train",
                "environment": "ant",
                "algorithm": {"kind": "ppo", "num_timesteps": 1_000_000},
                "video": None,
            },
            "method": "tpe",
            "parameters": {
                "algorithm.learning_rate": {"low": 1e-5, "high": 1e-2, "log": True},
                "algorithm.discounting": {"low": 0.9, "high": 0.999},
                "algorithm.unroll_length": {"low": 5, "high": 20, "step": 5},
            },
            "objective": {"metric": "eval/episode_reward", "direction": "maximize"},
            "budget": {"jobs": 20, "parallel": 2},
            "pruning": {"kind": "median", "startup_trials": 5},
        }
    },
    "population-based training": {
        "value": {
            "job": {
                "kind": "train",
                "environment": "ant",
                "algorithm": {"kind": "ppo", "num_timesteps": 20_000_000},
                "resources": {"accelerator": "gpu"},
                "video": None,
            },
            "method": "pbt",
            "parameters": {
                "algorithm.learning_rate": {"low": 1e-5, "high": 1e-2, "log": True},
                "algorithm.entropy_cost": {"low": 1e-4, "high": 1e-1, "log": True},
            },
            "population": {"size": 8, "generations": 5},
            "budget": {"parallel": 8},
        }
    },
}
