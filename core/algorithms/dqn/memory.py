"""The least memory of a DQN run."""

from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.memory import FLOAT_BYTES, Memory, Part, perceptron
from core.algorithms.off_policy.memory import environments_part, replay_part
from core.algorithms.q_learning.options import choice_space
from core.environments.info import EnvironmentInfo, FiniteSpace

# The parameters, their gradient, Adam's two moments, and the network that follows.
_COPIES = 5
_NOTHING = FiniteSpace(0, 0)


def least_memory(settings: DQNSpec, environment: EnvironmentInfo, num_devices: int) -> Memory:
    """Bytes, all in float32. Left out: the engine's own arrays, and activations. Unknown sizes count as 0."""
    space = _choices(settings, environment)
    outputs = space.num_parts * space.num_values
    network = perceptron([environment.observation_size or 0, *settings.hidden_layer_sizes, outputs])
    return Memory(
        (
            replay_part(settings, environment, space.num_parts),
            Part(
                f"a network of {network:,} parameters with its gradient, Adam's moments and the network that "
                "follows",
                FLOAT_BYTES * _COPIES * network,
                ("hidden_layer_sizes",),
            ),
            environments_part(settings, environment),
        )
    )


def num_parts(settings: DQNSpec, environment: EnvironmentInfo) -> int:
    """How many parts of the body choose for themselves; 0 where that is not known."""
    return _choices(settings, environment).num_parts


def _choices(settings: DQNSpec, environment: EnvironmentInfo) -> FiniteSpace:
    """A run without choices, which is refused elsewhere, has none."""
    space = choice_space(settings.action_set, environment) if settings.action_set is not None else None
    return space or _NOTHING
