"""Tabular Q-learning on the brittle stars: a table steers by a pattern generator."""

import math
from collections.abc import Mapping
from typing import Any

from core.algorithms.q_learning.spec import QLearningSpec
from core.environments.brittle_star.options import DirectedOptions, Options
from core.environments.info import Device

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


def brittle_star(options: Options) -> Mapping[Device, QLearningSpec]:
    """Nothing is tuned for joints."""
    if options.control == "joints":
        return {}
    towards = isinstance(options, DirectedOptions)
    settings = {
        **_TABLE,
        **({"state_discretizer": {"kind": "arm_towards_target"}} if towards else {}),
        "decisions_per_episode": math.ceil(options.episode_length / _DECISION_STEPS),
    }
    return {
        "cpu": QLearningSpec.model_validate({**settings, "num_envs": 20}),
        "gpu": QLearningSpec.model_validate({**settings, "num_envs": 100}),
    }
