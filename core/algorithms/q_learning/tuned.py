"""The environments that Q-learning has tuned values for: it steers brittle stars by a pattern generator."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from core.algorithms.q_learning.spec import QLearningSpec, steers_a_generator
from core.environments.brittle_star.options import DirectedOptions, Options
from core.environments.info import Device, EnvironmentInfo

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


# By environment, as its options say.
TUNED_BY_OPTIONS: dict[str, Callable[[Any], Mapping[Device, QLearningSpec]]] = {
    "brittle_star": brittle_star,
    "brittle_star_light_escape": brittle_star,
    "brittle_star_undirected": brittle_star,
}


def tuned(environment: EnvironmentInfo, device: Device) -> QLearningSpec:
    """The values that fit the environment on this device; all others are unset."""
    by_options = TUNED_BY_OPTIONS.get(environment.id)
    values = by_options(environment.option_values) if by_options else {}
    return values.get(device, QLearningSpec())


def environment_options(settings: QLearningSpec, environment_id: str) -> Mapping[str, Any]:
    """Options of the environment that its tuned values, or the job's action set, are made for."""
    steers = steers_a_generator(settings.action_set)
    return {"control": "cpg"} if environment_id in TUNED_BY_OPTIONS and steers else {}
