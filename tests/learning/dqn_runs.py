"""Small runs of DQN for the tests of learning."""

from typing import Any

from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.run import Run, make_run
from core.environments.environment import Environment

# 16 environments of 4 steps.
STEPS_PER_UPDATE = 64


def dqn_settings(**changes: Any) -> DQNSpec:
    """Settings under which a probe is learnt in seconds, with a choice of three actions."""
    return DQNSpec.model_validate(
        {
            "action_set": {"kind": "actions", "actions": [[-0.5], [0.0], [0.5]]},
            "num_timesteps": 150 * STEPS_PER_UPDATE,
            "num_envs": 16,
            "episode_length": 8,
            "unroll_length": 4,
            "batch_size": 64,
            "min_replay_size": 256,
            "max_replay_size": 2048,
            "grad_updates_per_step": 4,
            "learning_rate": 3e-3,
            "discounting": 0.5,
            "tau": 0.05,
            "epsilon": {"start": 1.0, "end": 0.5},
            "normalize_observations": False,
            "num_evals": 1,
            "hidden_layer_sizes": [32],
            **changes,
        }
    )


def dqn_run(
    environment: Environment,
    *,
    seed: int = 0,
    checkpoint_every_steps: int | None = None,
    resume: bytes | None = None,
    epoch_s: float = 1.0,
    **changes: Any,
) -> Run[Any]:
    return make_run(
        environment,
        dqn_settings(**changes),
        seed=seed,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        epoch_s=epoch_s,
    )
