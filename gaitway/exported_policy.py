"""A trained policy from `policy.npz`, with NumPy alone.

The file needs nothing else of the package: copy it to a robot that has NumPy. docs/export.md describes the
format.
"""

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]

# The second version has an encoder.
_FORMAT, _VERSIONS = "gaitway-policy", (1, 2)
_LEAST_DEVIATION = 0.001


@dataclass(frozen=True)
class Policy:
    """observation [..., observation_size] ↦ action [..., action_size], each component in [-1, 1].

    about: the contract. mean, std: of observations. max_abs: bound on normalised observations. layers:
    (kernel [inputs, outputs], bias [outputs]) of each. encoder: layers that see the numbers `encoded` of the
    observation, in a policy that has one; `layers` see the first half of their outputs, an intention, and
    then the other numbers.
    """

    about: Mapping[str, Any]
    mean: Array
    std: Array
    max_abs: float
    layers: tuple[tuple[Array, Array], ...]
    activation: Callable[[Array], Array]
    encoder: tuple[tuple[Array, Array], ...] = ()
    encoded: tuple[int, ...] = ()

    def __call__(self, observation: Any, noise: np.random.Generator | None = None) -> Array:
        """The action. observation: an array, or arrays by name. noise: to explore as in training."""
        seen = self._seen(observation)
        values = np.clip((seen - self.mean) / self.std, -self.max_abs, self.max_abs)
        if self.encoder:
            encoded = np.array(self.encoded)
            latent, log_std = self._halves(self.encoder, values[..., encoded])
            if noise is not None:
                latent = _drawn(latent, np.exp(log_std), noise)
            others: Array = np.delete(values, encoded, axis=-1)
            values = np.concatenate([latent, others], axis=-1)
        location, scale = self._halves(self.layers, values)
        if noise is not None:
            location = _drawn(location, _softplus(scale) + _LEAST_DEVIATION, noise)
        return np.tanh(location)

    def _halves(self, layers: Sequence[tuple[Array, Array]], values: Array) -> tuple[Array, Array]:
        """The two halves of what the layers give."""
        for kernel, bias in layers[:-1]:
            values = self.activation(values @ kernel + bias)
        kernel, bias = layers[-1]
        both: Array = values @ kernel + bias
        half = both.shape[-1] // 2
        return both[..., :half], both[..., half:]

    def _seen(self, observation: Any) -> Array:
        contract = self.about["observation"]
        if isinstance(observation, Mapping):
            return self._seen(cast("Mapping[str, Any]", observation)[contract["name"]])
        seen = np.asarray(observation, np.float32)
        if seen.shape[-1:] != (contract["size"],):
            raise ValueError(
                f"The observation has the shape {seen.shape}, and not [..., {contract['size']}]."
            )
        return seen


def load(path: str | os.PathLike[str] | BinaryIO) -> Policy:
    """The policy in a file that `gaitway export --format numpy` fetched. Raises ValueError for others."""
    with np.load(path, allow_pickle=False) as file:
        about: Any = json.loads(str(file["about"])) if "about" in file.files else {}
        if about.get("format") != _FORMAT or about.get("version") not in _VERSIONS:
            raise ValueError(f"This is not a {_FORMAT} of version {' or '.join(map(str, _VERSIONS))}.")
        network = about["network"]
        if network["activation"] not in _ACTIVATIONS:
            raise ValueError(f"There is no activation {network['activation']!r} here.")
        bound = network["normalized_max_abs"]
        encoder = network.get("encoder", {"num_layers": 0, "encoded": []})
        return Policy(
            about,
            file["observation_mean"],
            file["observation_std"],
            math.inf if bound is None else bound,
            tuple((file[f"kernel_{i}"], file[f"bias_{i}"]) for i in range(network["num_layers"])),
            _ACTIVATIONS[network["activation"]],
            tuple(
                (file[f"encoder_kernel_{i}"], file[f"encoder_bias_{i}"]) for i in range(encoder["num_layers"])
            ),
            tuple(encoder["encoded"]),
        )


def _drawn(mean: Array, deviation: Array, noise: np.random.Generator) -> Array:
    drawn = np.empty(mean.shape, np.float32)
    noise.standard_normal(dtype=np.float32, out=drawn)
    return mean + deviation * drawn


def _sigmoid(x: Array) -> Array:
    with np.errstate(over="ignore"):  # exp(-x) may be infinite: 1 / ∞ is the 0 that is right
        return 1 / (1 + np.exp(-x))


def _softplus(x: Array) -> Array:
    return np.logaddexp(x, np.float32(0))


def _elu(x: Array) -> Array:
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def _gelu(x: Array) -> Array:
    return x * (0.5 + 0.5 * np.tanh(math.sqrt(2 / math.pi) * (x + 0.044715 * x * x * x)))


# By Brax's names, as `jax.nn` has them.
_ACTIVATIONS: Mapping[str, Callable[[Array], Array]] = {
    "swish": lambda x: x * _sigmoid(x),
    "relu": lambda x: np.maximum(x, 0),
    "tanh": np.tanh,
    "elu": _elu,
    "gelu": _gelu,
    "leaky_relu": lambda x: np.where(x > 0, x, 0.01 * x),
    "selu": lambda x: (
        1.0507009873554805 * np.where(x > 0, x, 1.6732632423543772 * np.expm1(np.minimum(x, 0)))
    ),
    "sigmoid": _sigmoid,
    "softplus": _softplus,
}
