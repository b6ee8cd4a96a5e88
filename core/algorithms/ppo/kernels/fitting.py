"""Where our kernels take PPO's gradient steps; loads nothing that only a GPU needs."""

from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec

import jax

from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import ObservationSize

# A block of threads holds a tile of activations and a layer's gradient in its registers.
_WIDEST_LAYER, _WIDEST_OBSERVATION = 64, 128
# Those that Triton has, and that leave the padding at zero.
_ACTIVATIONS = ("tanh", "swish", "relu", "elu")
# Triton's matrix products begin with NVIDIA's Ampere.
_LEAST_COMPUTE_CAPABILITY = 8.0
_MOST_ROWS, _LEAST_ROWS = 64, 16
# Of a minibatch: each adds up what all tell of the advantages.
_MOST_BLOCKS = 64


@cache
def usable() -> bool:
    """Whether this process trains on a GPU for which JAX can make the kernels.

    JAX means to drop Pallas' way through Triton one day (0.12 warns of it): without it, XLA's operations
    take the steps, as they do for what does not fit.
    """
    if jax.default_backend() != "gpu" or find_spec("jax.experimental.pallas.triton") is None:
        return False
    capability = getattr(jax.local_devices()[0], "compute_capability", "0")
    return float(capability) >= _LEAST_COMPUTE_CAPABILITY


def fits(settings: PPOSpec, observation_size: ObservationSize, action_size: int) -> bool:
    """Whether the kernels compute the loss that the settings ask for, on networks of their size."""
    if isinstance(observation_size, Mapping):
        return False
    rows = rows_of_a_tile(settings.batch_size)
    num_observations = settings.batch_size * settings.num_minibatches * (settings.unroll_length + 1)
    widest = max(*settings.policy_hidden_layer_sizes, *settings.value_hidden_layer_sizes, action_size)
    return (
        widest <= _WIDEST_LAYER
        and observation_size <= _WIDEST_OBSERVATION
        and rows >= _LEAST_ROWS
        and settings.batch_size // rows <= _MOST_BLOCKS
        and num_observations * _WIDEST_OBSERVATION < 2**31  # Triton counts in 32 bits
        and settings.activation in _ACTIVATIONS
        and settings.normalize_advantage
        and settings.clipping_epsilon_value is None
        and settings.learning_rate_schedule != "ADAPTIVE_KL"
    )


def rows_of_a_tile(batch_size: int) -> int:
    """The largest power of two that divides the batch's unrolls, 64 at most."""
    return min(_MOST_ROWS, batch_size & -batch_size)
