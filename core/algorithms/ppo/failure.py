"""Whether an update gave a value that is not finite, and where."""

import jax
import jax.numpy as jnp

from core.algorithms.algorithm import Failure
from core.algorithms.brax_training import PPONetworkParams, Transition
from core.algorithms.experience import Outcome, lost_too_many

# Checked after each update, in the order in which one spoils the next.
QUANTITIES = (
    "observation",
    "reward",
    "policy loss",
    "value loss",
    "entropy loss",
    "gradient",
    "parameters",
)


def find_failure(
    transitions: Transition, outcome: Outcome, metrics: dict[str, jax.Array], params: PPONetworkParams
) -> Failure:
    """What went wrong in an update, if anything did.

    transitions, outcome: [T, N, ...]. metrics: means of the losses. params: after the update.
    """
    seen = jax.tree.leaves(transitions.next_observation)
    bad_obs = ~jnp.all(jnp.stack([jnp.all(jnp.isfinite(x), axis=(1, 2)) for x in seen]), axis=0)
    bad_obs |= lost_too_many(outcome)
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
