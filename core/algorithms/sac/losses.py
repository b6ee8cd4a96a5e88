"""The functions that a gradient step differentiates.

Source: Haarnoja et al., Soft Actor-Critic Algorithms and Applications (2018), eq. 5, 9 and 18; the critics'
distributions: see `critic`.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from core.algorithms.off_policy.replay import Sample
from core.algorithms.sac.networks import Networks, Params, projected

Scalar = Float[Array, ""]


def critic_loss(
    q: Any, params: Params, target_q: Any, networks: Networks, batch: Sample, key: jax.Array
) -> tuple[Scalar, Scalar]:
    """The cross-entropy of both critics with their common target, and the mean value that they expect.

    The target is the distribution of the critic that expects less, moved by the rewards, with the policy's
    entropy as a part of what follows. batch: normalised observations, scaled rewards.
    """
    following, log_prob = networks.sample(params.policy, batch.next_observation, key)
    target_logits = networks.critics.logits(target_q, batch.next_observation, following)
    distributions = jax.nn.softmax(target_logits)
    first, second = distributions @ networks.atoms
    of_less = jnp.where((first < second)[:, None], *distributions)
    worth = networks.atoms[None, :] - (jnp.exp(params.log_alpha) * log_prob)[:, None]
    moved = batch.reward[:, None] + batch.discount[:, None] * worth
    target = jax.lax.stop_gradient(projected(of_less, moved, networks.atoms))
    log_probabilities = jax.nn.log_softmax(networks.critics.logits(q, batch.observation, batch.action))
    losses = -jnp.sum(target[None] * log_probabilities, axis=-1)
    expected = jnp.exp(log_probabilities) @ networks.atoms
    return jnp.mean(losses * batch.weight) * len(losses), jnp.mean(expected)


def policy_loss(
    policy: Any, params: Params, networks: Networks, batch: Sample, key: jax.Array
) -> tuple[Scalar, Scalar]:
    """How much less than the most the policy gets, entropy included; and the actions' mean log-density."""
    action, log_prob = networks.sample(policy, batch.observation, key)
    value = jnp.min(networks.values(params.q, batch.observation, action), axis=0)
    return jnp.mean(jnp.exp(params.log_alpha) * log_prob - value), jnp.mean(log_prob)


def alpha_loss(log_alpha: Scalar, log_prob: Scalar, target_entropy: Scalar | float) -> Scalar:
    """It falls with a larger weight where the policy's entropy is below the wanted one."""
    return jnp.exp(log_alpha) * jax.lax.stop_gradient(-log_prob - target_entropy)
