"""Critics that estimate the distribution of the return over fixed values.

Source: Bellemare et al., A Distributional Perspective on Reinforcement Learning (2017), algorithm 1.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from core.algorithms.brax_training import networks

# Their smaller estimate counts (Fujimoto et al., Addressing Function Approximation Error, 2018).
NUM_CRITICS = 2


@dataclass(frozen=True)
class Critics:
    """Two networks from an observation and an action to logits over `num_atoms` values."""

    hidden_layer_sizes: tuple[int, ...]
    num_atoms: int
    activation: Any
    layer_norm: bool

    def init(self, key: jax.Array, observation_size: int, action_size: int) -> Any:
        """Random parameters, with both critics' in each array's first axis."""
        zeros = jnp.zeros((1, observation_size + action_size))
        return jax.vmap(lambda one: self._network.init(one, zeros))(jax.random.split(key, NUM_CRITICS))

    def logits(
        self, params: Any, observation: Float[Array, "B obs"], action: Float[Array, "B act"]
    ) -> Float[Array, "2 B atoms"]:
        given = jnp.concatenate([observation, action], axis=-1)
        return jax.vmap(self._network.apply, (0, None))(params, given)

    @property
    def _network(self) -> Any:
        return networks.MLP(
            layer_sizes=[*self.hidden_layer_sizes, self.num_atoms],
            activation=self.activation,
            layer_norm=self.layer_norm,
        )


def projected(
    probabilities: Float[Array, "B atoms"], moved: Float[Array, "B atoms"], atoms: Float[Array, " atoms"]
) -> Float[Array, "B atoms"]:
    """The distribution of values that have moved, over the fixed ones.

    Each value shares its probability between its neighbours; those beyond the ends stay at the ends.
    """
    # Fenced: for an H100, XLA fuses what comes before into one kernel with it, which compiles for minutes.
    probabilities, moved = jax.lax.optimization_barrier((probabilities, moved))
    spacing = atoms[1] - atoms[0]
    place = (jnp.clip(moved, atoms[0], atoms[-1]) - atoms[0]) / spacing
    shares = jnp.clip(1.0 - jnp.abs(place[:, None, :] - jnp.arange(len(atoms))[None, :, None]), 0.0, 1.0)
    # Fused by XLA: an einsum would store the shares.
    return jax.lax.optimization_barrier(jnp.sum(shares * probabilities[:, None, :], axis=-1))
