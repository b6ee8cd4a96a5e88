"""PPO's policy as an encoder of intentions and a decoder that moves the body.

z = μ(reference) + σ(reference) ε with ε from a standard normal distribution, and the action's distribution is
that of the decoder for z and the body. PPO compares how likely an action is now with how likely it was when
it was taken, and both must be of the same policy: ε is therefore kept with each action, as if it were part of
what was seen. The ratio is then 1 before the first step of learning, and its gradient reaches the encoder
through μ and σ; with new noise in the loss it would be neither.

Source: Merel et al., Neural Probabilistic Motor Primitives for Humanoid Control (2019); the weights are those
of track-mjx (Zhang et al., MIMIC-MJX, 2025), which takes means over the numbers of z, too.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from core.algorithms.brax_training import networks

LATENT_METRICS = ("latent_kl", "latent_std", "latent_step", "kl_weight")

Normalize = Callable[[Any, Any], Any]


@struct.dataclass
class Latent:
    """The distribution of z: mean, log_std [..., latent]. body: what the decoder sees besides, [..., n]."""

    mean: jax.Array
    log_std: jax.Array
    body: jax.Array

    def sample(self, noise: jax.Array) -> jax.Array:
        """z for standard normal noise, both [..., latent]."""
        return self.mean + jnp.exp(self.log_std) * noise

    @property
    def divergence(self) -> jax.Array:
        """KL(N(μ, σ²) ‖ N(0, 1)), the mean over the numbers of z, [...] in nats.

        Source: Kingma & Welling, Auto-Encoding Variational Bayes (2014), appendix B.
        """
        terms = jnp.square(self.mean) + jnp.exp(2 * self.log_std) - 1 - 2 * self.log_std
        return 0.5 * jnp.mean(terms, axis=-1)

    def step(self, continues: jax.Array) -> jax.Array:
        """The mean square by which z's mean moves from one action to the next, []; time is the first axis.

        continues: [T, B], 1 where the next action is of the same episode, else 0.
        """
        moved = jnp.mean(jnp.square(self.mean[1:] - self.mean[:-1]), axis=-1)
        return jnp.sum(moved * continues[:-1]) / jnp.maximum(jnp.sum(continues[:-1]), 1.0)


class Bound(NamedTuple):
    """A network under this noise, as Brax's functions take one."""

    apply: Callable[[Any, Any, Any], jax.Array]


@dataclass(frozen=True)
class IntentionPolicy:
    """The policy's network. Like Brax's it has `init` and `apply`; without noise z is its mean.

    encoder, decoder: perceptrons. places: the numbers of the observation that the encoder sees, and those
    that the decoder sees. key: the observation, where there are several by name. normalize: (observation,
    normaliser) -> observation.
    """

    encoder: networks.MLP
    decoder: networks.MLP
    places: tuple[np.ndarray, np.ndarray]
    latent: int
    key: str
    normalize: Normalize

    def init(self, key: jax.Array) -> Any:
        """Random parameters."""
        encoder_key, decoder_key = jax.random.split(key)
        seen, body = (len(places) for places in self.places)
        encoder = self.encoder.init(encoder_key, jnp.zeros((1, seen)))
        decoder = self.decoder.init(decoder_key, jnp.zeros((1, self.latent + body)))
        return {"params": {"encoder": encoder["params"], "decoder": decoder["params"]}}

    def encode(self, normalizer: Any, params: Any, observation: Any) -> Latent:
        """The distribution of z for observations [..., n]."""
        if isinstance(observation, Mapping):
            observation = observation[self.key]
            normalizer = networks.normalizer_select(normalizer, self.key)
        values = self.normalize(observation, normalizer)
        reference, body = (values[..., places] for places in self.places)
        encoded: Any = self.encoder.apply({"params": params["params"]["encoder"]}, reference)
        mean, log_std = jnp.split(encoded, 2, axis=-1)
        return Latent(mean, log_std, body)

    def decode(self, params: Any, z: jax.Array, body: jax.Array) -> jax.Array:
        """The parameters of the action's distribution, [..., 2 × action_size]. body: normalised."""
        seen = jnp.concatenate([z, body], axis=-1)
        decoded: Any = self.decoder.apply({"params": params["params"]["decoder"]}, seen)
        return decoded

    def apply(self, normalizer: Any, params: Any, observation: Any) -> jax.Array:
        """The parameters of the action's distribution where z is its mean."""
        latent = self.encode(normalizer, params, observation)
        return self.decode(params, latent.mean, latent.body)

    def noise(self, key: jax.Array, observation: Any) -> jax.Array:
        """Standard normal noise for observations [..., n]: [..., latent]."""
        if isinstance(observation, Mapping):
            observation = observation[self.key]
        return jax.random.normal(key, (*observation.shape[:-1], self.latent))

    def under(self, noise: jax.Array) -> Bound:
        """The network whose z has this noise."""

        def apply(normalizer: Any, params: Any, observation: Any) -> jax.Array:
            latent = self.encode(normalizer, params, observation)
            return self.decode(params, latent.sample(noise), latent.body)

        return Bound(apply)
