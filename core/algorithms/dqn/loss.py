"""The function that a gradient step differentiates."""

from typing import Any

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

from core.algorithms.dqn.network import QNetwork
from core.algorithms.exploration import greedy
from core.algorithms.off_policy.replay import Sample

Scalar = Float[Array, ""]


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
