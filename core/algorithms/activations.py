"""What each layer of a policy's network gives for the observations of an episode."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from core.algorithms import layers as names
from core.algorithms.brax_training import networks
from core.algorithms.export.network import PolicyNetwork

Numbers = NDArray[np.float32]
# As `jax.random.PRNGKey` makes them, one a row.
Keys = NDArray[np.uint32]
# (kernel [inputs, outputs], bias [outputs]) of each.
Layers = Sequence[tuple[Any, Any]]
# Standard normal noise [latent] of an intention, from the key with which the policy acted.
LatentNoise = Callable[[jax.Array], jax.Array]

# Steps that are computed at once. Episodes are filled up to a multiple, so that one program does for all.
_ROWS = 1000


class ActivationReader:
    """Reads the activations of a policy's network; compiled once for episodes of any length.

    latent_noise: that of intentions; None: z is its mean.
    """

    def __init__(self, network: PolicyNetwork, latent_noise: LatentNoise | None = None) -> None:
        self.network = network
        self.sizes = _sizes(network)
        self._latent_noise = latent_noise
        self._weights = tuple(
            [(layer.kernel, layer.bias) for layer in layers] for layers in (network.encoder, network.layers)
        )
        self._all = jax.jit(jax.vmap(self._of_a_step, (None, 0, 0)))

    def read(self, observations: Numbers, keys: Keys, chosen: Collection[str]) -> dict[str, Numbers]:
        """The activations [T, size] of the chosen layers, after their non-linearity; a network's last layer
        has none. observations: [T, observation_size]; keys: with which the policy acted, [T, 2]."""
        parts = [
            self._part(observations[start : start + _ROWS], keys[start : start + _ROWS], chosen)
            for start in range(0, len(observations), _ROWS)
        ]
        return {name: np.concatenate([part[name] for part in parts]) for name in chosen}

    def _part(self, observations: Numbers, keys: Keys, chosen: Collection[str]) -> Mapping[str, Numbers]:
        filled = ((0, _ROWS - len(observations)), (0, 0))
        with jax.default_matmul_precision("highest"):
            found = self._all(self._weights, np.pad(observations, filled), np.pad(keys, filled))
        return {name: np.asarray(found[name])[: len(observations)] for name in chosen}

    def _of_a_step(
        self, weights: Sequence[Layers], observation: jax.Array, key: jax.Array
    ) -> dict[str, jax.Array]:
        network, (encoder, layers) = self.network, weights
        activation = cast("Any", networks.ACTIVATION[network.activation])
        seen = (observation - network.mean) / network.std
        if network.max_abs is not None:
            seen = jnp.clip(seen, -network.max_abs, network.max_abs)
        if not network.encoder:
            return _named(names.POLICY, _through(layers, seen, activation))
        *hidden, last = _through(encoder, seen[np.array(network.encoded)], activation)
        mean, log_std = jnp.split(last, 2)
        std = jnp.exp(log_std)
        z = mean if self._latent_noise is None else mean + std * self._latent_noise(key)
        body = seen[np.array(network.not_encoded, int)]
        decoded = _through(layers, jnp.concatenate([z, body]), activation)
        return {
            **_named(names.ENCODER, hidden),
            names.LATENT_MEAN: mean,
            names.LATENT_STD: std,
            names.LATENT_SAMPLE: z,
            **_named(names.DECODER, decoded),
        }


def _sizes(network: PolicyNetwork) -> dict[str, int]:
    hidden = [len(layer.bias) for layer in network.layers[:-1]]
    if not network.encoder:
        return names.plain(hidden, network.action_size)
    *encoder, latent = (len(layer.bias) for layer in network.encoder)
    return names.intention(encoder, latent // 2, hidden, network.action_size)


def _through(
    layers: Layers, values: jax.Array, activation: Callable[[jax.Array], jax.Array]
) -> Iterator[jax.Array]:
    """What each layer gives."""
    *hidden, (last_kernel, last_bias) = layers
    for kernel, bias in hidden:
        values = activation(values @ kernel + bias)
        yield values
    yield values @ last_kernel + last_bias


def _named(network: str, values: Iterable[jax.Array]) -> dict[str, jax.Array]:
    return {f"{network}/{number}": one for number, one in enumerate(values)}
