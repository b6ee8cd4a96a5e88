"""Small runs of SAC for the tests of learning."""

from typing import Any

from core.algorithms.run import Run, make_run
from core.algorithms.sac.spec import SACSpec
from core.environments.environment import Environment

# 16 environments of 4 steps.
STEPS_PER_UPDATE = 64


def sac_settings(**changes: Any) -> SACSpec:
    """Settings under which a probe is learnt in seconds. The entropy's weight is small, so that values are
    those of the rewards."""
    return SACSpec.model_validate(
        {
            "num_timesteps": 150 * STEPS_PER_UPDATE,
            "num_envs": 16,
            "episode_length": 8,
            "unroll_length": 4,
            "batch_size": 64,
            "min_replay_size": 256,
            "max_replay_size": 2048,
            "grad_updates_per_step": 4,
            "n_step": 1,
            "learning_rate": 3e-3,
            "discounting": 0.5,
            "tau": 0.05,
            "num_atoms": 41,
            "value_min": -2.5,
            "value_max": 2.5,
            "init_alpha": 1e-3,
            "target_entropy_per_action": -3.0,
            "normalize_observations": False,
            "num_evals": 1,
            "policy_hidden_layer_sizes": [32],
            "q_hidden_layer_sizes": [32],
            **changes,
        }
    )


def sac_run(
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
        sac_settings(**changes),
        seed=seed,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        epoch_s=epoch_s,
    )
