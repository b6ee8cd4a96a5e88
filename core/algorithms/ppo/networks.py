"""Brax's networks for this project's settings, and how they act."""

from collections.abc import Mapping
from typing import Any, cast

import jax
import numpy as np

from core.algorithms.brax_training import (
    PPONetworkParams,
    PPONetworks,
    identity_observation_preprocessor,
    make_inference_fn,
    make_ppo_networks,
    normalization,
)
from core.algorithms.brax_training import networks as brax_networks
from core.algorithms.evaluation import Policy
from core.algorithms.ppo.intention import IntentionPolicy
from core.algorithms.ppo.network_spec import IntentionNetwork
from core.algorithms.ppo.spec import PPOSpec
from core.environments.environment import ObservationSize
from core.errors import Problem, Rejected


def make_networks(
    observation_size: ObservationSize, action_size: int, settings: PPOSpec, *, normalize: bool = True
) -> PPONetworks:
    """The policy and value networks. normalize: whether they take raw observations, or normalised ones.

    Raises ValueError if the observations have names, and the one that the settings name is missing; Rejected
    where the settings have an encoder and do not say what it sees, or what is no part of the observation.
    """
    preprocess: Any = identity_observation_preprocessor
    if normalize:
        preprocess = normalization(settings.normalize_observations_max_abs_value)
    if isinstance(observation_size, Mapping):
        for key in (settings.policy_obs_key, settings.value_obs_key):
            if key not in observation_size:
                raise ValueError(f"There is no observation {key!r}; there are {sorted(observation_size)}.")
    made = make_ppo_networks(
        observation_size,  # pyright: ignore[reportArgumentType] - sizes do as well as shapes
        action_size,
        preprocess_observations_fn=preprocess,
        policy_hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
        value_hidden_layer_sizes=tuple(settings.value_hidden_layer_sizes),
        activation=cast("Any", brax_networks.ACTIVATION[settings.activation]),
        policy_obs_key=settings.policy_obs_key,
        value_obs_key=settings.value_obs_key,
    )
    if settings.network is None:
        return made
    size: Any = observation_size
    if isinstance(size, Mapping):
        size = size[settings.policy_obs_key]
    policy = _intention(settings.network, size, action_size, settings, preprocess)
    return cast("Any", made).replace(policy_network=policy)


def _intention(
    network: IntentionNetwork, observation_size: int, action_size: int, settings: PPOSpec, preprocess: Any
) -> IntentionPolicy:
    if network.places is None:
        detail = (
            "This environment does not name the parts of its observation: say by `places` what is encoded."
        )
        raise Rejected(detail, [Problem("/algorithm/network/places", detail)])
    network.checked(network.places, observation_size)
    seen = np.concatenate([start + np.arange(size) for start, size in network.places])
    activation = cast("Any", brax_networks.ACTIVATION[settings.activation])
    return IntentionPolicy(
        encoder=brax_networks.MLP([*network.encoder, 2 * network.latent], activation=activation),
        decoder=brax_networks.MLP([*network.decoder, 2 * action_size], activation=activation),
        places=(seen, np.setdiff1d(np.arange(observation_size), seen)),
        latent=network.latent,
        key=settings.policy_obs_key,
        normalize=preprocess,
    )


def acting(
    networks: PPONetworks,
    params: tuple[Any, ...],
    *,
    deterministic: bool = False,
    compute_value: bool = False,
) -> Policy:
    """(observations, key) -> (actions, what the loss needs of them: see Brax's `make_inference_fn`).

    params: (normaliser, policy, value). An encoder's noise is `latent_noise`, [..., latent].
    """
    network: Any = networks.policy_network
    if deterministic or not isinstance(network, IntentionPolicy):
        return make_inference_fn(networks, compute_value)(params, deterministic)

    def act(observation: Any, key: jax.Array) -> tuple[jax.Array, Any]:
        action_key, latent_key = jax.random.split(key)
        noise = network.noise(latent_key, observation)
        under_it = cast("Any", networks).replace(policy_network=network.under(noise))
        action, extras = make_inference_fn(under_it, compute_value)(params)(observation, action_key)
        return action, {**extras, "latent_noise": noise}

    return act


def init_params(networks: PPONetworks, key: jax.Array) -> PPONetworkParams:
    """Random parameters."""
    policy_key, value_key = jax.random.split(key)
    parameters: Any = PPONetworkParams  # a flax dataclass by a name that type checkers do not follow
    return parameters(
        policy=networks.policy_network.init(policy_key), value=networks.value_network.init(value_key)
    )
