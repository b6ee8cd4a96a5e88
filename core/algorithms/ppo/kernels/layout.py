"""Where the parameters of both networks lie in one vector, padded to what a GPU's matrix units take.

A layer's sides are rounded up to powers of two, 16 at least. What is added is zero and stays zero: an
activation of 0 is 0, so nothing flows through it, and Adam does not move what has no gradient.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

_LEAST = 16


def rounded_up(size: int) -> int:
    """The next power of two, 16 at least."""
    return max(_LEAST, 1 << (size - 1).bit_length())


@dataclass(frozen=True)
class Layer:
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
class Layout:
    """policy: hidden layers, then the one of the means, then the one of the deviations. value: hidden layers,
    then one with a single output."""

    policy: tuple[Layer, ...]
    value: tuple[Layer, ...]

    @classmethod
    def of(
        cls, observation_size: int, action_size: int, policy: Sequence[int], value: Sequence[int]
    ) -> "Layout":
        """policy, value: sizes of the hidden layers."""
        of_policy = _layers("policy", observation_size, [*policy, action_size], 0)
        means = of_policy[-1]
        deviations = Layer(means.network, means.name, action_size, means.inputs, action_size, means.end)
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


def _layers(network: str, inputs: int, sizes: Sequence[int], start: int) -> list[Layer]:
    found = list[Layer]()
    for index, outputs in enumerate(sizes):
        found.append(Layer(network, f"hidden_{index}", 0, inputs, outputs, start))
        inputs, start = outputs, found[-1].end
    return found


def _joined(parts: Sequence[Mapping[str, jax.Array]]) -> dict[str, jax.Array]:
    return {name: jnp.concatenate([part[name] for part in parts], axis=-1) for name in ("kernel", "bias")}
