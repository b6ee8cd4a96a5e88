"""The function that an update differentiates: Brax's loss, on one minibatch."""

from collections.abc import Callable
from typing import Any

import jax

from core.algorithms.brax_training import (
    PPONetworkParams,
    RunningStatisticsState,
    Transition,
    compute_ppo_loss,
)
from core.algorithms.ppo.hyperparameters import Hyperparameters
from core.algorithms.ppo.spec import PPOSpec

Loss = Callable[[PPONetworkParams, Transition, jax.Array], tuple[jax.Array, dict[str, jax.Array]]]


def loss_of(
    settings: PPOSpec, networks: Any, normalizer: RunningStatisticsState, hyperparameters: Hyperparameters
) -> Loss:
    """(parameters, minibatch [unrolls, unroll_length, ...], key) -> (loss [], its parts by Brax's names).

    networks: do not normalise, because that is done once for the batch, not in every minibatch.
    Source: Schulman et al., Proximal Policy Optimization Algorithms (2017), eq. 9.
    """
    clips_values = settings.clipping_epsilon_value is not None
    bound = hyperparameters.clipping_epsilon_value if clips_values else None

    def loss(params: PPONetworkParams, minibatch: Transition, key: jax.Array) -> Any:
        return compute_ppo_loss(
            params,
            normalizer,  # not used: these networks do not normalise
            minibatch,
            key,
            networks,
            entropy_cost=hyperparameters.entropy_cost,  # pyright: ignore[reportArgumentType]
            discounting=hyperparameters.discounting,  # pyright: ignore[reportArgumentType]
            reward_scaling=hyperparameters.reward_scaling,  # pyright: ignore[reportArgumentType]
            gae_lambda=hyperparameters.gae_lambda,  # pyright: ignore[reportArgumentType]
            clipping_epsilon=hyperparameters.clipping_epsilon,  # pyright: ignore[reportArgumentType]
            normalize_advantage=settings.normalize_advantage,
            vf_coefficient=hyperparameters.vf_loss_coefficient,  # pyright: ignore[reportArgumentType]
            clipping_epsilon_value=bound,  # pyright: ignore[reportArgumentType]
        )

    return loss
