"""Whether an update brought a value that is not finite, and where."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from core.algorithms.ppo.brax_training import PPONetworkParams, Transition
from core.algorithms.ppo.experience import Outcome

# What is looked at after each update, in the order in which one spoils the next.
QUANTITIES = (
    "observation",
    "reward",
    "policy loss",
    "value loss",
    "entropy loss",
    "gradient",
    "parameters",
)


class Failure(NamedTuple):
    """Which of QUANTITIES were not finite in an update, and at which of its time steps, if it was there.

    quantities: [len(QUANTITIES)] bool. time_step: [] int32, the first at which an observation or reward
    was not finite; the number of time steps if none was.
    """

    quantities: jax.Array
    time_step: jax.Array


def find_failure(
    transitions: Transition, outcome: Outcome, metrics: dict[str, jax.Array], params: PPONetworkParams
) -> Failure:
    """What went wrong in an update, if anything did.

    transitions, outcome: [T, N, ...]. metrics: means of the losses. params: after the update.
    """
    seen = jax.tree.leaves(transitions.next_observation)
    bad_obs = ~jnp.all(jnp.stack([jnp.all(jnp.isfinite(x), axis=(1, 2)) for x in seen]), axis=0)
    bad_reward = ~jnp.all(jnp.isfinite(outcome.reward), axis=1)
    bad_params = [~jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(params)]
    losses = [metrics[name] for name in ("policy_loss", "v_loss", "entropy_loss", "grad_norm")]
    quantities = jnp.stack(
        [
            jnp.any(bad_obs),
            jnp.any(bad_reward),
            *(~jnp.isfinite(value) for value in losses),
            jnp.any(jnp.stack(bad_params)),
        ]
    )
    bad = bad_obs | bad_reward
    first = jnp.where(jnp.any(bad), jnp.argmax(bad), len(bad)).astype(jnp.int32)
    return Failure(quantities, first)
