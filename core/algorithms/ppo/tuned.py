"""The environments that PPO has tuned values for.

To add some, write {"cpu": ..., "gpu": ...} here, and its line in `_BY_ENVIRONMENT`, or in
`TUNED_BY_OPTIONS` if they depend on options.

On a GPU, the inverted pendulum and the reacher have what Brax's training notebook has for them, with our own
numbers of evaluations. The others were chosen for the time to a mark: on an H200, and on two cores.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from core.algorithms.ppo.spec import PPOSpec
from core.environments.brittle_star.options import (
    DirectedOptions,
    LightEscapeOptions,
    Options,
    UndirectedOptions,
)
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.rodent.info import RodentOptions
from core.environments.external.brax.info import SAME_TASK
from core.environments.info import CRITIC_GROUP, Device, EnvironmentInfo
from core.environments.locomotion.humanoid import HumanoidOptions
from core.environments.robots.info import G1Options, Go1Options
from core.environments.terms.task import TaskOptions

_CPU: Mapping[str, Any] = {
    "num_timesteps": 5_000_000,
    "num_envs": 256,
    "unroll_length": 20,
    "batch_size": 128,
    "num_minibatches": 16,
    "num_updates_per_batch": 4,
    "learning_rate": 6e-4,
    "entropy_cost": 1e-3,
    "reward_scaling": 1.0,
    "normalize_observations": True,
}
_GPU: Mapping[str, Any] = {
    "num_timesteps": 50_000_000,
    "num_evals": 2,
    "num_envs": 2048,
    "unroll_length": 20,
    "batch_size": 1024,
    "num_minibatches": 32,
    "num_updates_per_batch": 4,
    "learning_rate": 3e-4,
    "entropy_cost": 1e-3,
    "reward_scaling": 1.0,
    "normalize_observations": True,
}


def _cpu(**own: Any) -> PPOSpec:
    return PPOSpec.model_validate({**_CPU, **own})


def _gpu(**own: Any) -> PPOSpec:
    return PPOSpec.model_validate({**_GPU, **own})


def _lasting(*, entropy_cost: float = 1e-2, **own: Any) -> PPOSpec:
    """Without these two, some seeds lose late what they had learnt (docs/experiments/gpu_tuning.md)."""
    return _gpu(learning_rate_schedule="LINEAR", entropy_cost=entropy_cost, **own)


ANT: Mapping[Device, PPOSpec] = {
    # Chosen among 40 variants on two cores (docs/experiments/cpu_training.md), for the time to a running ant.
    "cpu": _cpu(
        num_timesteps=3_000_000,
        unroll_length=10,
        batch_size=64,
        num_minibatches=8,
        learning_rate=1e-3,
        learning_rate_schedule="LINEAR",
        entropy_cost=1e-2,
        discounting=0.98,
        clipping_epsilon=0.2,
        reward_scaling=0.1,
        value_hidden_layer_sizes=[64, 64],
        activation="tanh",
    ),
    "gpu": _gpu(
        num_evals=1,
        unroll_length=5,
        num_minibatches=8,
        learning_rate=1e-3,
        entropy_cost=1e-2,
        discounting=0.97,
        clipping_epsilon=0.2,
        value_hidden_layer_sizes=[64, 64],
        activation="tanh",
    ),
}
HALF_CHEETAH: Mapping[Device, PPOSpec] = {
    "cpu": _cpu(num_timesteps=3_000_000, discounting=0.95),
    # With Brax's 0.95 and 3e-4, some seeds stay at a return of 2,000 (docs/experiments/gpu_tuning.md).
    "gpu": _lasting(
        num_evals=3,
        batch_size=512,
        num_updates_per_batch=8,
        learning_rate=6e-4,
        entropy_cost=3e-2,  # With 1e-2 six of nine seeds were slower, and one of 23 stayed at 2,600.
        discounting=0.97,
    ),
}
HOPPER: Mapping[Device, PPOSpec] = {
    "cpu": _cpu(discounting=0.99),
    "gpu": _lasting(num_envs=1024, batch_size=256, num_minibatches=16, learning_rate=6e-4, discounting=0.99),
}
WALKER2D: Mapping[Device, PPOSpec] = {
    "cpu": _cpu(discounting=0.99),
    "gpu": _lasting(
        num_envs=512,
        batch_size=128,
        num_minibatches=16,
        learning_rate=6e-4,
        discounting=0.99,
        value_hidden_layer_sizes=[256, 256],
    ),
}
HUMANOID: Mapping[Device, PPOSpec] = {
    "cpu": _cpu(
        num_timesteps=10_000_000,
        unroll_length=10,
        batch_size=256,
        learning_rate=3e-4,
        discounting=0.97,
        reward_scaling=0.1,
    ),
    "gpu": _gpu(
        num_evals=3,
        unroll_length=10,
        batch_size=512,
        num_minibatches=16,
        learning_rate=6e-4,
        learning_rate_schedule="LINEAR",
        clipping_epsilon=0.2,
        discounting=0.97,
        reward_scaling=0.1,
        value_hidden_layer_sizes=[256, 256],
    ),
}
INVERTED_PENDULUM: Mapping[Device, PPOSpec] = {
    # At a constant learning rate one of three seeds fell from 1,000 to 108 in the last evaluation.
    "cpu": _cpu(
        num_timesteps=500_000,
        num_envs=128,
        unroll_length=10,
        num_minibatches=8,
        discounting=0.97,
        learning_rate_schedule="LINEAR",
    ),
    "gpu": _gpu(
        num_timesteps=2_000_000,
        num_evals=1,
        unroll_length=5,
        discounting=0.97,
        entropy_cost=1e-2,
        reward_scaling=10.0,
    ),
}
REACHER: Mapping[Device, PPOSpec] = {
    "cpu": _cpu(discounting=0.95, reward_scaling=5.0),
    "gpu": _gpu(
        unroll_length=50, batch_size=256, num_updates_per_batch=8, discounting=0.95, reward_scaling=5.0
    ),
}


_STAR_CPU: Mapping[str, Any] = {
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
_STAR_GPU: Mapping[str, Any] = {
    **_STAR_CPU,
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
    return {
        "cpu": PPOSpec.model_validate({**_STAR_CPU, **cpu}),
        "gpu": PPOSpec.model_validate({**_STAR_GPU, **gpu}),
    }


_COMMON: Mapping[str, Any] = {
    "num_minibatches": 8,
    "num_updates_per_batch": 4,
    "learning_rate": 1e-3,
    "entropy_cost": 1e-2,
    "discounting": 0.97,
    "reward_scaling": 0.1,
    "clipping_epsilon": 0.2,
    "normalize_observations": True,
    "value_hidden_layer_sizes": [64, 64],
    "activation": "tanh",
}
_MJCF_CPU: Mapping[str, Any] = {
    **_COMMON,
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "unroll_length": 10,
    "batch_size": 64,
}
_MJCF_GPU: Mapping[str, Any] = {
    **_COMMON,
    "num_timesteps": 50_000_000,
    "num_evals": 3,
    "num_envs": 2048,
    "unroll_length": 5,
    "batch_size": 1024,
}
MJCF: Mapping[Device, PPOSpec] = {
    "cpu": PPOSpec.model_validate(_MJCF_CPU),
    "gpu": PPOSpec.model_validate(_MJCF_GPU),
}


_RUNNER_CPU: Mapping[str, Any] = {
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
_RUNNER_GPU: Mapping[str, Any] = {
    **_RUNNER_CPU,
    "num_timesteps": 30_000_000,
    "num_evals": 1,  # Two would take the rodent more than 5 % of its run, and the ant 2 to 4 s of a minute.
    "num_envs": 2048,
    "batch_size": 512,
    "num_minibatches": 32,
}
_ANT_ACTS_EVERY_S = 0.04

RODENT: Mapping[Device, PPOSpec] = {
    "cpu": PPOSpec.model_validate(_RUNNER_CPU),
    "gpu": PPOSpec.model_validate(_RUNNER_GPU),
}


_JOYSTICK: Mapping[str, Any] = {
    "num_evals": 2,
    "num_eval_envs": 128,
    "num_updates_per_batch": 4,
    "learning_rate": 2e-3,
    "learning_rate_schedule": "LINEAR",
    "entropy_cost": 0.01,
    "discounting": 0.97,
    "reward_scaling": 0.15,
    "clipping_epsilon": 0.2,
    "max_grad_norm": 1.0,
    "normalize_observations": True,
    "activation": "elu",
    "bootstrap_on_timeout": True,
    "random_initial_episode_length": True,
}


def _joystick(steps: int, steps_on_a_cpu: int) -> Mapping[Device, PPOSpec]:
    """The values for a robot that walks by command."""
    on_a_gpu = {
        "num_envs": 8192,
        "unroll_length": 6,
        "batch_size": 1024,
        "num_minibatches": 8,
        "policy_hidden_layer_sizes": [256, 256, 128],
        "value_hidden_layer_sizes": [256, 256, 128],
    }
    on_a_cpu = {
        "num_envs": 256,
        "unroll_length": 8,
        "batch_size": 128,
        "num_minibatches": 8,
        "policy_hidden_layer_sizes": [128, 128, 64],
        "value_hidden_layer_sizes": [128, 128, 64],
    }
    return {
        "cpu": PPOSpec.model_validate({**_JOYSTICK, **on_a_cpu, "num_timesteps": steps_on_a_cpu}),
        "gpu": PPOSpec.model_validate({**_JOYSTICK, **on_a_gpu, "num_timesteps": steps}),
    }


def imitating(**on_a_gpu: Any) -> Mapping[Device, PPOSpec]:
    """The values for a body that follows clips. Its starts are spread over them, and so are its ends."""
    own = {
        "discounting": 0.98,
        "entropy_cost": 0.002,
        "reset_pool_size": 1024,
        "random_initial_episode_length": False,
    }
    values = _joystick(50_000_000, 16_000_000)
    return {
        # At twice this rate, 75 % of a G1's starts came to the clip's end after 24 M steps; at this, all.
        "cpu": values["cpu"].model_copy(update={**own, "learning_rate": 1e-3}),
        "gpu": values["gpu"].model_copy(update={**own, **on_a_gpu}),
    }


G1 = _joystick(24_000_000, 10_000_000)
GO1 = _joystick(12_000_000, 3_000_000)


# Five seconds to get up; what is earned while standing counts from the ground on.
_GET_UP: Mapping[str, Any] = {
    "episode_length": 250,
    "discounting": 0.98,
    "entropy_cost": 0.02,
    "reward_scaling": 0.08,
}


def g1(options: G1Options) -> Mapping[Device, PPOSpec]:
    """The values for the G1's tasks."""
    match options.task:
        case "walk":
            return G1
        case "rough":
            return _joystick(130_000_000, 30_000_000)
        case "imitate":
            return imitating()


def go1(options: Go1Options) -> Mapping[Device, PPOSpec]:
    """The values for the Go1's tasks."""
    match options.task:
        case "walk":
            return GO1
        case "rough":
            return _joystick(250_000_000, 30_000_000)
        case "get_up":
            values = _joystick(70_000_000, 10_000_000)
            return {device: settings.model_copy(update=_GET_UP) for device, settings in values.items()}


def rodent(options: RodentOptions) -> Mapping[Device, PPOSpec]:
    """The values for the rat's tasks."""
    if options.task != "imitate":
        return RODENT
    return imitating(
        num_timesteps=40_000_000,
        num_envs=2048,  # More rats side by side take a GPU as many times longer.
        unroll_length=20,
        batch_size=256,
        learning_rate=5e-4,  # At 2e-3, half as many starts stayed near to the clips.
        policy_hidden_layer_sizes=[512, 256, 256],
        value_hidden_layer_sizes=[512, 256, 256],
    )


def humanoid(options: HumanoidOptions) -> Mapping[Device, PPOSpec]:
    """The values for the humanoid's tasks."""
    return imitating() if options.task == "imitate" else HUMANOID


def own_model(options: TaskOptions) -> Mapping[Device, PPOSpec]:
    """The values for a user's own model or a package's: a robot's where servos' targets follow a command."""
    if options.reference is not None and options.action.kind == "joint_position":
        return imitating()
    walks = options.command is not None and options.action.kind == "joint_position"
    return _joystick(30_000_000, 6_000_000) if walks else MJCF


def corridor(options: CorridorOptions) -> Mapping[Device, PPOSpec]:
    """The values for a walker in a corridor.

    The ant holds each action for 0.04 s: with a new one every 0.01 s its exploration is only a tremble.
    """
    held: Mapping[str, Any] = {}
    if options.walker == "ant":
        num_steps = round(_ANT_ACTS_EVERY_S / (options.timestep * options.n_frames))
        held = {"action_repeat": max(1, num_steps), "discounting": 0.97}
    return {
        "cpu": PPOSpec.model_validate({**_RUNNER_CPU, **held}),
        "gpu": PPOSpec.model_validate({**_RUNNER_GPU, **held}),
    }


SETTINGS = Path(__file__).parent / "playground.json"

# Playground tunes for 2048 environments on a GPU. On a CPU, MJX finishes this budget in an hour or two; an
# update has as many actions per environment, and as many gradient steps, as on the GPU.
_ON_A_CPU: Mapping[str, Any] = {
    "num_timesteps": 3_000_000,
    "num_envs": 256,
    "batch_size": 128,
    "reset_pool_size": 32,
}


def _read() -> dict[str, Mapping[Device, PPOSpec]]:
    found: dict[str, Mapping[Device, PPOSpec]] = {}
    settings: dict[str, Any] = json.loads(SETTINGS.read_text())
    for name, own in settings["environments"].items():
        ppo = {**settings["shared"], **own}
        found[f"playground/{name}"] = {
            "cpu": PPOSpec.model_validate({**ppo, **_ON_A_CPU}),
            "gpu": PPOSpec.model_validate(ppo),
        }
    return found


PLAYGROUND = _read()


_BY_ENVIRONMENT: dict[str, Mapping[Device, PPOSpec]] = {
    "ant": ANT,
    "half_cheetah": HALF_CHEETAH,
    "hopper": HOPPER,
    "humanoid": HUMANOID,
    "inverted_pendulum": INVERTED_PENDULUM,
    "mjcf": MJCF,
    "reacher": REACHER,
    "rodent": RODENT,
    "walker2d": WALKER2D,
    **PLAYGROUND,
}
# By environment. Brax's registry has no tuned settings; a task that is also ours has ours.
TUNED = {**_BY_ENVIRONMENT, **{theirs: _BY_ENVIRONMENT[ours] for theirs, ours in SAME_TASK.items()}}
# By environment: values that depend on its options.
TUNED_BY_OPTIONS: dict[str, Callable[[Any], Mapping[Device, PPOSpec]]] = {
    "brittle_star": brittle_star,
    "brittle_star_light_escape": brittle_star,
    "brittle_star_undirected": brittle_star,
    "corridor": corridor,
    "g1": g1,
    "go1": go1,
    "humanoid": humanoid,
    "mjcf": own_model,
    "rodent": rodent,
}


def tuned(environment: EnvironmentInfo, device: Device) -> PPOSpec:
    """The values that fit the environment on this device; all others are unset."""
    values = TUNED.get(environment.id, {})
    is_of_a_package = environment.tuned is not None
    by_options = TUNED_BY_OPTIONS.get("mjcf" if is_of_a_package else environment.id)
    if by_options and (environment.chosen is not None or not environment.takes_model):
        values = by_options(environment.option_values)
    own = values.get(device, PPOSpec())
    if CRITIC_GROUP in environment.observations:
        return own.model_copy(update={"value_obs_key": CRITIC_GROUP})
    return own
