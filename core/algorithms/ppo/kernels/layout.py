"""Where the parameters of both networks lie in one vector, which is padded to what a GPU's matrix units take.

A layer's sides are rounded up to powers of two, 16 at least. What is added is zero and stays zero: an
activation of 0 is 0, so nothing flows through it, and Adam does not move what has no gradient. Also which
settings the kernels can take.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp

from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import ObservationSize

_LEAST = 16


def rounded_up(size: int) -> int:
    """The next power of two, 16 at least."""
    return max(_LEAST, 1 << (size - 1).bit_length())


@dataclass(frozen=True)
class KernelLayer:
    """Columns from `first` on of a flax layer. Its kernel begins at `start`, and its bias follows."""

    network: str
    name: str
    first: int
    inputs: int
    outputs: int
    start: int

    @property
    def rows(self) -> int:
        return rounded_up(self.inputs)

    @property
    def columns(self) -> int:
        return rounded_up(self.outputs)

    @property
    def bias(self) -> int:
        """Where the bias begins."""
        return self.start + self.rows * self.columns

    @property
    def end(self) -> int:
        return self.bias + self.columns


@dataclass(frozen=True)
class KernelLayout:
    """policy: hidden layers, then the one of the means, then the one of the deviations. value: hidden layers,
    then one with a single output."""

    policy: tuple[KernelLayer, ...]
    value: tuple[KernelLayer, ...]

    @classmethod
    def of(
        cls, observation_size: int, action_size: int, policy: Sequence[int], value: Sequence[int]
    ) -> "KernelLayout":
        """policy, value: sizes of the hidden layers."""
        of_policy = _layers("policy", observation_size, [*policy, action_size], 0)
        means = of_policy[-1]
        deviations = KernelLayer(means.network, means.name, action_size, means.inputs, action_size, means.end)
        of_policy = [*of_policy, deviations]
        return cls(tuple(of_policy), tuple(_layers("value", observation_size, [*value, 1], deviations.end)))

    @property
    def size(self) -> int:
        return self.value[-1].end

    def pack(self, params: Any) -> jax.Array:
        """The vector [size] of both networks' parameters, or of what is shaped like them."""
        parts = list[jax.Array]()
        for layer in (*self.policy, *self.value):
            of_flax = getattr(params, layer.network)["params"][layer.name]
            columns = slice(layer.first, layer.first + layer.outputs)
            wider = layer.columns - layer.outputs
            kernel = jnp.pad(of_flax["kernel"][:, columns], ((0, layer.rows - layer.inputs), (0, wider)))
            parts += [kernel.ravel(), jnp.pad(of_flax["bias"][columns], (0, wider))]
        return jnp.concatenate(parts)

    def unpack(self, vector: jax.Array, like: Any) -> Any:
        """The reverse; like: parameters of the wanted type."""
        found: dict[str, dict[str, list[Mapping[str, jax.Array]]]] = {"policy": {}, "value": {}}
        for layer in (*self.policy, *self.value):
            kernel = vector[layer.start : layer.bias].reshape(layer.rows, layer.columns)
            found[layer.network].setdefault(layer.name, []).append(
                {
                    "kernel": kernel[: layer.inputs, : layer.outputs],
                    "bias": vector[layer.bias : layer.bias + layer.outputs],
                }
            )
        networks = {
            network: {"params": {name: _joined(parts) for name, parts in layers.items()}}
            for network, layers in found.items()
        }
        return type(like)(**networks)


def _layers(network: str, inputs: int, sizes: Sequence[int], start: int) -> list[KernelLayer]:
    found = list[KernelLayer]()
    for index, outputs in enumerate(sizes):
        found.append(KernelLayer(network, f"hidden_{index}", 0, inputs, outputs, start))
        inputs, start = outputs, found[-1].end
    return found


def _joined(parts: Sequence[Mapping[str, jax.Array]]) -> dict[str, jax.Array]:
    return {name: jnp.concatenate([part[name] for part in parts], axis=-1) for name in ("kernel", "bias")}


@dataclass(frozen=True)
class KernelSizes:
    """unroll_length: T. batch_size: B, unrolls of a minibatch. interpret: without a GPU."""

    layout: KernelLayout
    activation: Callable[[jax.Array], jax.Array]
    action_size: int
    unroll_length: int
    batch_size: int
    interpret: bool = False

    @property
    def rows(self) -> int:
        """Rows of a tile: unrolls at one time."""
        return rows_of_a_tile(self.batch_size)

    @property
    def samples(self) -> int:
        """Samples of a minibatch."""
        return self.batch_size * self.unroll_length

    @property
    def num_tiles(self) -> int:
        return self.samples // self.rows

    @property
    def num_blocks(self) -> int:
        """Blocks of unrolls; one block of threads estimates the advantages of each."""
        return self.batch_size // self.rows


# A block of threads holds a tile of activations and a layer's gradient in its registers.
_WIDEST_LAYER, _WIDEST_OBSERVATION = 64, 128
# Activations that Triton supports and that map zero padding to zero.
_ACTIVATIONS = ("tanh", "swish", "relu", "elu")
# Triton's matrix products begin with NVIDIA's Ampere.
_LEAST_COMPUTE_CAPABILITY = 8.0
_MOST_ROWS, _LEAST_ROWS = 64, 16
# Most blocks per minibatch; every block sums the advantage statistics of all.
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
        settings.network is None
        and widest <= _WIDEST_LAYER
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
