"""Small runs for the tests of learning."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from core.algorithms.brax_training import init_normalizer
from core.algorithms.distillation.spec import DistillationSpec
from core.algorithms.events import CheckpointReady, Evaluated, Event
from core.algorithms.policy_file import PolicyConfig, PolicyParams, write_policy
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.run import Run, make_run
from core.algorithms.trained_policy import TrainedPolicy, load_policy
from core.environments.environment import Environment

# 32 environments of 4 steps, in 4 minibatches of 32 unrolls: 512 environment steps in an update.
STEPS_PER_UPDATE = 512

# For `probes.intention`: an encoder of the first number that is seen.
INTENTION: dict[str, Any] = {
    "kind": "intention",
    "latent": 2,
    "encoder": [16],
    "decoder": [16],
    "places": [[0, 1]],
    "kl_weight": 1e-3,
}


def small_settings(**changes: Any) -> PPOSpec:
    """Settings under which a probe is learnt in seconds."""
    return PPOSpec.model_validate(
        {
            "num_timesteps": 40 * STEPS_PER_UPDATE,
            "num_envs": 32,
            "episode_length": 8,
            "unroll_length": 4,
            "batch_size": 32,
            "num_minibatches": 4,
            "num_updates_per_batch": 4,
            "learning_rate": 3e-3,
            "entropy_cost": 0.0,
            "discounting": 0.5,
            "num_evals": 1,
            "policy_hidden_layer_sizes": [16],
            "value_hidden_layer_sizes": [16],
            **changes,
        }
    )


def small_run(
    environment: Environment,
    *,
    seed: int = 0,
    checkpoint_every_steps: int | None = None,
    resume: bytes | None = None,
    devices: int = 1,
    epoch_s: float = 1.0,
    **changes: Any,
) -> Run[Any]:
    return make_run(
        environment,
        small_settings(**changes),
        seed=seed,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        devices=devices,
        epoch_s=epoch_s,
    )


def linear_expert(*weights: float) -> TrainedPolicy:
    """One that takes the action tanh(weights · observation)."""
    # relu(w x) - relu(-w x) = w x, of which the first of the two outputs is the mean.
    column = np.array(weights, np.float32)[:, None]
    layers = {
        "hidden_0": {"kernel": np.hstack([column, -column]), "bias": np.zeros(2, np.float32)},
        "hidden_1": {"kernel": np.array([[1, 0], [-1, 0]], np.float32), "bias": np.zeros(2, np.float32)},
    }
    params = PolicyParams(init_normalizer(len(weights)), {"params": layers}, {}, PolicyConfig("relu"))
    return load_policy(write_policy(params), "distillation", is_checkpoint=False)


def distillation_run(
    environment: Environment,
    *policies: TrainedPolicy,
    experts: Sequence[Mapping[str, Any]] = ({},),
    seed: int = 0,
    checkpoint_every_steps: int | None = None,
    resume: bytes | None = None,
    epoch_s: float = 1.0,
    **changes: Any,
) -> Run[Any]:
    """Of 128 steps in an update. experts: their fields besides the job."""
    settings = {
        "num_timesteps": 40 * 128,
        "num_envs": 32,
        "episode_length": 8,
        "unroll_length": 4,
        "num_minibatches": 4,
        "learning_rate": 3e-3,
        "num_evals": 1,
        "policy_hidden_layer_sizes": [16],
        "experts": [
            {"job": f"00000000000{number}-0000000000", **said} for number, said in enumerate(experts)
        ],
        **changes,
    }
    return make_run(
        environment,
        DistillationSpec.model_validate(settings),
        seed=seed,
        checkpoint_every_steps=checkpoint_every_steps,
        resume=resume,
        epoch_s=epoch_s,
        experts=policies,
    )


def last_evaluation(events: Iterator[Event]) -> dict[str, float]:
    """The metrics of the last evaluation of a run, which is trained to its end."""
    evaluations = [event for event in events if isinstance(event, Evaluated)]
    return dict(evaluations[-1].metrics)


def checkpoints(run: Run[Any]) -> dict[int, bytes]:
    """Every checkpoint that a run asks for, by its step."""
    return {event.step: run.checkpoint() for event in run.events() if isinstance(event, CheckpointReady)}
