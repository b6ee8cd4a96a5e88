"""Tests of the whole service that run on a CPU and, where there is one, on a GPU."""

from typing import Any

import pytest

from tests.compiling import compiling_quickly

ACCELERATORS = [pytest.param("cpu", marks=pytest.mark.slow), pytest.param("gpu", marks=pytest.mark.gpu)]
# PPO whose updates take a moment on a CPU: 8 × 10 steps.
TINY: dict[str, Any] = {
    "num_envs": 8,
    "unroll_length": 10,
    "batch_size": 4,
    "num_minibatches": 2,
    "episode_length": 20,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
}


def use(accelerator: str, environment: pytest.MonkeyPatch) -> None:
    """Let a worker that starts in this environment have it: the CPU also where there is a GPU."""
    if accelerator == "cpu":
        for name, value in {**compiling_quickly(), "JAX_PLATFORMS": "cpu"}.items():
            environment.setenv(name, value)
