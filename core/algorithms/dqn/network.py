"""The network, how it acts, and what it learns from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from core.algorithms.brax_training import networks
from core.algorithms.evaluation import Policy
from core.algorithms.experience import Scalar, epsilon_greedy, greedy
from core.algorithms.off_policy.replay import Sample
from core.environments.environment import ActionSet


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


def td_loss(params: Any, target: Any, network: QNetwork, batch: Sample) -> tuple[Scalar, dict[str, Scalar]]:
    """Huber's loss of the TD errors, and the mean value and size of error for the metrics.

    Each part of the body learns from the same reward and its own best next choice, as the arms of a table
    do. The network that learns says which choice is best, and `target`, which follows it, what that is worth.
    batch: normalised observations, scaled rewards; actions are choices [B, parts].
    Source: van Hasselt et al., Deep Reinforcement Learning with Double Q-learning (2016), eq. 4; Mnih et al.,
    Human-level control through deep reinforcement learning (2015), whose errors are clipped, as Huber's
    gradient is.
    """
    best = greedy(network.values(params, batch.next_observation))
    follows = _of(network.values(target, batch.next_observation), best)
    wanted = jax.lax.stop_gradient(batch.reward[:, None] + batch.discount[:, None] * follows)
    expected = _of(network.values(params, batch.observation), batch.action.astype(jnp.int32))
    loss = jnp.mean(batch.weight[:, None] * optax.huber_loss(expected, wanted))
    error = jnp.mean(batch.weight[:, None] * jnp.abs(wanted - expected))
    return loss, {"loss": loss, "q_value": jnp.mean(expected), "td_error": error}


def _of(values: Float[Array, "B parts choices"], choices: Int[Array, "B parts"]) -> Float[Array, "B parts"]:
    return jnp.take_along_axis(values, choices[..., None], axis=-1)[..., 0]
