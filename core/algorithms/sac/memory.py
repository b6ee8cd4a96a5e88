"""The least memory of a SAC run."""

from core.algorithms.memory import FLOAT_BYTES, Memory, Part, perceptron
from core.algorithms.sac.spec import SACSpec
from core.environments.info import EnvironmentInfo

# Reward, and how the step ended.
_SCALARS = 3
_CRITICS = 2
# The parameters, their gradient, and Adam's two moments; and the critics that follow.
_COPIES, _COPIES_OF_CRITICS = 4, 5


def replay_bytes(settings: SACSpec, environment: EnvironmentInfo) -> int:
    """The size of the replay, on the device and in a checkpoint. Unknown sizes count as 0."""
    observation, action = environment.observation_size or 0, environment.action_size or 0
    return FLOAT_BYTES * settings.replay_rows * settings.num_envs * (observation + action + _SCALARS)


def least_memory(settings: SACSpec, environment: EnvironmentInfo, num_devices: int) -> Memory:
    """Bytes, all in float32. Left out: the engine's own arrays, and activations. Unknown sizes count as 0."""
    observation, action = environment.observation_size or 0, environment.action_size or 0
    kept = settings.replay_rows * settings.num_envs
    # The policy puts out a mean and a deviation for each component.
    policy = perceptron([observation, *settings.policy_hidden_layer_sizes, 2 * action])
    critic = perceptron([observation + action, *settings.q_hidden_layer_sizes, settings.num_atoms])
    numbers = _COPIES * policy + _COPIES_OF_CRITICS * _CRITICS * critic
    return Memory(
        (
            Part(
                f"the {kept:,} transitions that are kept",
                replay_bytes(settings, environment),
                ("max_replay_size",),
            ),
            Part(
                f"networks of {policy + _CRITICS * critic:,} parameters with their gradient, Adam's moments "
                "and the critics that follow",
                FLOAT_BYTES * numbers,
                ("policy_hidden_layer_sizes", "q_hidden_layer_sizes"),
            ),
            Part(
                f"{settings.num_envs:,} environments",
                FLOAT_BYTES * settings.num_envs * (observation + 1),
                ("num_envs",),
            ),
        )
    )
