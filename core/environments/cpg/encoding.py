"""A star's modulation as one action in [-1, 1], and back.

In this order, with n = 2 num_arms oscillators: amplitudes [n], offsets [n], phase biases along the edges
[3 num_arms] as parts of π, frequency [1]. An amplitude or frequency of 0 is -1, an offset or bias of 0 is 0.
"""

from typing import Protocol

import jax
import jax.numpy as jnp

from core.environments.cpg import star
from core.environments.cpg.oscillators import Modulation


class Bounds(Protocol):
    """What the ends of an action mean: amplitudes lie in [0, max_amplitude], offsets in ± max_offset, both in
    the unit of the output, and the frequency that all oscillators share in [0, max_frequency] rad/s."""

    @property
    def max_amplitude(self) -> float: ...

    @property
    def max_offset(self) -> float: ...

    @property
    def max_frequency(self) -> float: ...


def action_size(num_arms: int) -> int:
    return 7 * num_arms + 1


def encode(modulation: Modulation, bounds: Bounds) -> jax.Array:
    """The action [..., 7 num_arms + 1] that `decode` takes for this modulation of one shared frequency."""
    return jnp.concatenate(
        [
            modulation.amplitudes / bounds.max_amplitude * 2 - 1,
            modulation.offsets / bounds.max_offset,
            star.along_edges(modulation.phase_biases) / jnp.pi,
            modulation.frequencies[..., :1] / bounds.max_frequency * 2 - 1,
        ],
        axis=-1,
    )


def decode(action: jax.Array, bounds: Bounds) -> Modulation:
    """The modulation that an action [..., 7 num_arms + 1] stands for."""
    n = 2 * ((action.shape[-1] - 1) // 7)
    amplitudes, offsets, biases, frequency = jnp.split(action, [n, 2 * n, action.shape[-1] - 1], axis=-1)
    return Modulation(
        amplitudes=(amplitudes + 1) / 2 * bounds.max_amplitude,
        offsets=offsets * bounds.max_offset,
        frequencies=(frequency + 1) / 2 * bounds.max_frequency,
        phase_biases=star.between_all(biases * jnp.pi),
    )
