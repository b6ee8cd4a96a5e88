"""Brax's networks for this project's settings."""

from typing import Any

import jax
import jax.numpy as jnp
from brax.training.acme import running_statistics, specs
from brax.training.acme.running_statistics import RunningStatisticsState
from brax.training.agents.ppo.losses import PPONetworkParams
from brax.training.agents.ppo.networks import PPONetworks, make_ppo_networks
from brax.training.types import identity_observation_preprocessor

from core.algorithms.ppo.spec import PPOSpec

# (normaliser, policy, value): what Brax saves, and what its inference functions take.
PolicyParams = tuple[RunningStatisticsState, Any, Any]


def make_networks(
    observation_size: int, action_size: int, settings: PPOSpec, *, normalize: bool = True
) -> PPONetworks:
    """The policy and value networks. normalize: whether they take raw observations, or normalised ones."""
    preprocess: Any = running_statistics.normalize if normalize else identity_observation_preprocessor
    return make_ppo_networks(
        observation_size,
        action_size,
        preprocess_observations_fn=preprocess,
        policy_hidden_layer_sizes=tuple(settings.policy_hidden_layer_sizes),
        value_hidden_layer_sizes=tuple(settings.value_hidden_layer_sizes),
    )


def init_params(networks: PPONetworks, key: jax.Array) -> PPONetworkParams:
    """Random parameters."""
    policy_key, value_key = jax.random.split(key)
    parameters: Any = PPONetworkParams  # a flax dataclass by a name that type checkers do not follow
    return parameters(
        policy=networks.policy_network.init(policy_key), value=networks.value_network.init(value_key)
    )


def init_normalizer(observation_size: int) -> RunningStatisticsState:
    """Mean 0 and deviation 1: the identity, until it is updated."""
    state = running_statistics.init_state(specs.Array((observation_size,), jnp.dtype("float32")))
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, getattr(leaf, "dtype", jnp.float32)), state)
