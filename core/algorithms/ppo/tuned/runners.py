"""PPO on dm_control's runners: the rodent in the open, and the walkers in a corridor."""

from collections.abc import Mapping
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.info import Device

_CPU: Mapping[str, Any] = {
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "unroll_length": 10,
    "batch_size": 256,
    "num_minibatches": 8,
    "num_updates_per_batch": 4,
    "learning_rate": 3e-4,
    "discounting": 0.98,
    "entropy_cost": 1e-3,
    "reward_scaling": 0.1,
    "normalize_observations": True,
    "normalize_observations_max_abs_value": 10.0,
    "random_initial_episode_length": True,
}
# 80 actions per environment and update, as on a CPU: with 20 the value function diverged in the corridor.
_GPU: Mapping[str, Any] = {
    **_CPU,
    "num_timesteps": 30_000_000,
    "num_evals": 1,  # Two would take the rodent more than 5 % of its run, and the ant 2 to 4 s of a minute.
    "num_envs": 2048,
    "batch_size": 512,
    "num_minibatches": 32,
}
_ANT_ACTS_EVERY_S = 0.04

RODENT: Mapping[Device, PPOSpec] = {"cpu": PPOSpec.model_validate(_CPU), "gpu": PPOSpec.model_validate(_GPU)}


def corridor(options: CorridorOptions) -> Mapping[Device, PPOSpec]:
    """The values for a walker in a corridor.

    The ant holds each action for 0.04 s: with a new one every 0.01 s its exploration is only a tremble.
    """
    held: Mapping[str, Any] = {}
    if options.walker == "ant":
        num_steps = round(_ANT_ACTS_EVERY_S / (options.timestep * options.n_frames))
        held = {"action_repeat": max(1, num_steps), "discounting": 0.97}
    return {
        "cpu": PPOSpec.model_validate({**_CPU, **held}),
        "gpu": PPOSpec.model_validate({**_GPU, **held}),
    }
