"""Brax's networks for this project's settings."""

from collections.abc import Mapping
from typing import Any, cast

import jax

from core.algorithms.brax_training import (
    PPONetworkParams,
    PPONetworks,
    identity_observation_preprocessor,
    make_ppo_networks,
    normalization,
)
from core.algorithms.brax_training import networks as brax_networks
from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import ObservationSize


def make_networks(
    observation_size: ObservationSize, action_size: int, settings: PPOSpec, *, normalize: bool = True
) -> PPONetworks:
    """The policy and value networks. normalize: whether they take raw observations, or normalised ones.

    Raises ValueError if the observations have names, and the one that the settings name is missing.
    """
    preprocess: Any = identity_observation_preprocessor
    if normalize:
        preprocess = normalization(settings.normalize_observations_max_abs_value)
    if isinstance(observation_size, Mapping):
        for key in (settings.policy_obs_key, settings.value_obs_key):
            if key not in observation_size:
                raise ValueError(f"There is no observation {key!r}; there are {sorted(observation_size)}.")
    return make_ppo_networks(
        observation_size,  # pyright: ignore[reportArgumentType] - sizes do as well as shapes
        action_size,
        preprocess_observations_fn=preprocess,
        policy_hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
        value_hidden_layer_sizes=tuple(settings.value_hidden_layer_sizes),
        activation=cast("Any", brax_networks.ACTIVATION[settings.activation]),
        policy_obs_key=settings.policy_obs_key,
        value_obs_key=settings.value_obs_key,
    )


def init_params(networks: PPONetworks, key: jax.Array) -> PPONetworkParams:
    """Random parameters."""
    policy_key, value_key = jax.random.split(key)
    parameters: Any = PPONetworkParams  # a flax dataclass by a name that type checkers do not follow
    return parameters(
        policy=networks.policy_network.init(policy_key), value=networks.value_network.init(value_key)
    )
