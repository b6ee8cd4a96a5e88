"""Hyperparameters that fit a brittle star, by algorithm and device."""

import math
from collections.abc import Mapping
from typing import Any

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
_GPU = {**_CPU, "num_timesteps": 20_000_000, "num_evals": 4, "num_envs": 2048, "batch_size": 1024}
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


def ppo(options: Options) -> Mapping[Device, Mapping[str, Any]]:
    """PPO's hyperparameters, for joints or for the parameters of a pattern generator."""
    scaling = _REWARD_SCALING[type(options)]
    common = {"reward_scaling": scaling, "episode_length": options.episode_length}
    if options.control == "joints":
        return {"cpu": {**_CPU, **common}, "gpu": {**_GPU, **common}}
    common |= {**_GENERATOR, "reward_scaling": scaling / 5}  # Ten steps' rewards are added up.
    return {"cpu": {**_CPU, **common}, "gpu": {**_GPU, **common, "batch_size": 512}}


# A decision is one stroke of the default gait.
_DECISION_STEPS = 25
_TABLE: Mapping[str, Any] = {
    "action_set": {"kind": "leading_arm"},
    "num_episodes": 100,
    "decision_steps": _DECISION_STEPS,
    "learning_rate": 0.05,
    "discounting": 0.2,
    "epsilon": {"start": 0.5, "end": 0.1, "shape": "exponential"},
    "num_evals": 1,
}


def q_learning(options: Options) -> Mapping[Device, Mapping[str, Any]]:
    """What a table needs to steer by a pattern generator; nothing where there is none."""
    if options.control == "joints":
        return {}
    towards = isinstance(options, DirectedOptions)
    settings = {
        **_TABLE,
        **({"state_discretizer": {"kind": "arm_towards_target"}} if towards else {}),
        "decisions_per_episode": math.ceil(options.episode_length / _DECISION_STEPS),
    }
    return {"cpu": {**settings, "num_envs": 20}, "gpu": {**settings, "num_envs": 100}}
