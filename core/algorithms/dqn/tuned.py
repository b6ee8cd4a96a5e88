"""The environments that DQN has tuned values for: brittle stars that it steers by a pattern generator."""

from collections.abc import Callable, Mapping
from typing import Any

from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.q_learning.spec import steers_a_generator
from core.environments.brittle_star.options import DirectedOptions
from core.environments.info import Device, EnvironmentInfo

# A choice is held for one stroke of the default gait, as the table's is. A reward is a metre.
_STEERED: Mapping[str, Any] = {
    "action_set": {"kind": "leading_arm"},
    "num_timesteps": 200_000,
    "num_envs": 20,
    "action_repeat": 25,
    "unroll_length": 1,
    "reset_pool_size": 4,
    "grad_updates_per_step": 8,
    "batch_size": 128,
    "min_replay_size": 400,
    "max_replay_size": 20_000,
    "learning_rate": 1e-3,
    "discounting": 0.2,
    "reward_scaling": 10.0,
    "epsilon": {"start": 1.0, "end": 0.1},
    "num_evals": 1,
}


def brittle_star(options: DirectedOptions) -> Mapping[Device, DQNSpec]:
    """Nothing is tuned for joints."""
    if options.control == "joints":
        return {}
    settings = DQNSpec.model_validate(_STEERED)
    return {"cpu": settings, "gpu": settings}


# By environment, as its options say.
TUNED_BY_OPTIONS: dict[str, Callable[[Any], Mapping[Device, DQNSpec]]] = {"brittle_star": brittle_star}


def tuned(environment: EnvironmentInfo, device: Device) -> DQNSpec:
    """The values that fit the environment on this device; all others are unset."""
    by_options = TUNED_BY_OPTIONS.get(environment.id)
    values = by_options(environment.option_values) if by_options else {}
    return values.get(device, DQNSpec())


def environment_options(settings: DQNSpec, environment_id: str) -> Mapping[str, Any]:
    """Options of the environment that its tuned values, or the job's action set, are made for."""
    steers = steers_a_generator(settings.action_set)
    return {"control": "cpg"} if environment_id in TUNED_BY_OPTIONS and steers else {}
