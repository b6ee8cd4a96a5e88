"""The network, and how it acts."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from core.algorithms.brax_training import networks
from core.algorithms.evaluation import Policy
from core.algorithms.exploration import Scalar, epsilon_greedy, greedy
from core.environments.discretization import ActionSet


@dataclass(frozen=True)
class QNetwork:
    """From normalised observations to the value of each choice of each part that chooses for itself."""

    num_parts: int
    num_choices: int
    hidden_layer_sizes: tuple[int, ...]
    activation: str

    def init(self, key: jax.Array, observation_size: int) -> Any:
        """Random parameters."""
        return self._network.init(key, jnp.zeros((1, observation_size)))

    def values(self, params: Any, observation: Float[Array, "*N obs"]) -> Float[Array, "*N parts choices"]:
        flat = self._network.apply(params, observation)
        return flat.reshape(*flat.shape[:-1], self.num_parts, self.num_choices)

    def choose(
        self, params: Any, observation: Float[Array, "*N obs"], epsilon: Scalar | None, key: jax.Array
    ) -> Int[Array, "*N parts"]:
        """The best choices, but with probability epsilon any; None: always the best."""
        values = self.values(params, observation)
        return greedy(values) if epsilon is None else epsilon_greedy(values, epsilon, key)

    @property
    def _network(self) -> Any:
        return networks.MLP(
            layer_sizes=[*self.hidden_layer_sizes, self.num_parts * self.num_choices],
            activation=cast("Any", networks.ACTIVATION[self.activation]),
        )


def acting(
    network: QNetwork,
    action_set: ActionSet,
    params: Any,
    normalize: Callable[[Any], Any],
    epsilon: Scalar | None = None,
) -> Policy:
    """The policy as a function of raw observations [N, obs]; its extras hold the choices, as float32."""

    def act(observation: Any, key: jax.Array) -> tuple[jax.Array, Any]:
        choices = network.choose(params, normalize(observation), epsilon, key)
        return jax.vmap(action_set.act)(choices), {"action": choices.astype(jnp.float32)}

    return act
