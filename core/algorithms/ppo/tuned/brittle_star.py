"""PPO on the brittle stars, for their joints or for the parameters of their pattern generator."""

from collections.abc import Mapping
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.brittle_star.options import (
    DirectedOptions,
    LightEscapeOptions,
    Options,
    UndirectedOptions,
)
from core.environments.info import Device

_CPU: Mapping[str, Any] = {
    "num_timesteps": 1_000_000,
    "num_envs": 128,
    "unroll_length": 16,
    "batch_size": 128,
    "num_minibatches": 8,
    "num_updates_per_batch": 4,
    "learning_rate": 3e-4,
    "discounting": 0.98,
    "entropy_cost": 1e-3,
    "normalize_observations": True,
}
_GPU: Mapping[str, Any] = {
    **_CPU,
    "num_timesteps": 20_000_000,
    "num_evals": 4,
    "num_envs": 2048,
    "batch_size": 1024,
}
# A pattern generator takes some time to follow an action, so each is held for 0.4 s.
_GENERATOR: Mapping[str, Any] = {
    "action_repeat": 10,
    "unroll_length": 5,
    "batch_size": 32,
    "num_minibatches": 4,
    "num_updates_per_batch": 8,
    "learning_rate": 1e-3,
    "discounting": 0.8,
}
# The unit of the first two tasks' reward is a metre; that of the third is the whole range of light.
_REWARD_SCALING = {DirectedOptions: 100.0, UndirectedOptions: 100.0, LightEscapeOptions: 1000.0}


def brittle_star(options: Options) -> Mapping[Device, PPOSpec]:
    scaling = _REWARD_SCALING[type(options)]
    if options.control == "joints":
        return _of(cpu={"reward_scaling": scaling}, gpu={"reward_scaling": scaling})
    own = {**_GENERATOR, "reward_scaling": scaling / 5}  # The rewards of ten steps are added up.
    return _of(cpu=own, gpu={**own, "batch_size": 512})


def _of(cpu: Mapping[str, Any], gpu: Mapping[str, Any]) -> Mapping[Device, PPOSpec]:
    return {"cpu": PPOSpec.model_validate({**_CPU, **cpu}), "gpu": PPOSpec.model_validate({**_GPU, **gpu})}
