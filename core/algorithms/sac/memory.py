"""The least memory of a SAC run."""

from core.algorithms.memory import FLOAT_BYTES, Memory, Part, perceptron
from core.algorithms.off_policy.memory import environments_part, replay_part
from core.algorithms.sac.spec import SACSpec
from core.environments.info import EnvironmentInfo

_CRITICS = 2
# The parameters, their gradient, and Adam's two moments; and the critics that follow.
_COPIES, _COPIES_OF_CRITICS = 4, 5


def least_memory(settings: SACSpec, environment: EnvironmentInfo, num_devices: int) -> Memory:
    """Bytes, all in float32. Left out: the engine's own arrays, and activations. Unknown sizes count as 0."""
    observation, action = environment.observation_size or 0, environment.action_size or 0
    # The policy puts out a mean and a deviation for each component.
    policy = perceptron([observation, *settings.policy_hidden_layer_sizes, 2 * action])
    critic = perceptron([observation + action, *settings.q_hidden_layer_sizes, settings.num_atoms])
    numbers = _COPIES * policy + _COPIES_OF_CRITICS * _CRITICS * critic
    return Memory(
        (
            replay_part(settings, environment, action),
            Part(
                f"networks of {policy + _CRITICS * critic:,} parameters with their gradient, Adam's moments "
                "and the critics that follow",
                FLOAT_BYTES * numbers,
                ("policy_hidden_layer_sizes", "q_hidden_layer_sizes"),
            ),
            environments_part(settings, environment),
        )
    )
