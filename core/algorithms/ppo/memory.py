"""The least memory of a PPO run."""

from core.algorithms.memory import FLOAT_BYTES, Memory, Part, perceptron
from core.algorithms.ppo.spec import PPOSpec
from core.environments.info import EnvironmentInfo

# Reward, discount, truncation, and the log-probability of the action.
_SCALARS = 4
# The parameters, their gradient, and Adam's two moments.
_COPIES = 4


def least_memory(settings: PPOSpec, environment: EnvironmentInfo, num_devices: int) -> Memory:
    """Bytes on each device, all in float32.

    Left out, because they cannot be bounded from below without loading the environment: the engine's own
    arrays, activations, the next observations and the copies that XLA makes while it shuffles. Unknown
    sizes count as 0.
    """
    observation, action = environment.observation_size or 0, environment.action_size or 0
    transitions = settings.batch_size * settings.num_minibatches * settings.unroll_length // num_devices
    numbers = observation + action + _SCALARS
    # The policy puts out a mean and a deviation for each component.
    parameters = perceptron([observation, *settings.policy_hidden_layer_sizes, 2 * action])
    parameters += perceptron([observation, *settings.value_hidden_layer_sizes, 1])
    num_envs = settings.num_envs // num_devices
    return Memory(
        (
            Part(
                f"the {transitions:,} transitions of one update",
                FLOAT_BYTES * transitions * numbers,
                ("batch_size", "num_minibatches", "unroll_length"),
            ),
            Part(
                f"networks of {parameters:,} parameters with their gradient and Adam's moments",
                FLOAT_BYTES * _COPIES * parameters,
                ("policy_hidden_layer_sizes", "value_hidden_layer_sizes"),
            ),
            # Their observations; the rest of their state depends on the model.
            Part(f"{num_envs:,} environments", FLOAT_BYTES * num_envs * (observation + 1), ("num_envs",)),
        )
    )
