"""PPO's and SAC's policies: a normaliser, a network, and a normal distribution whose samples tanh bounds.

Source: brax.training (running_statistics.normalize, networks.MLP, distribution.NormalTanhDistribution).
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from gaitway.errors import PolicyUnreadable
from gaitway.policies import brax_file, checkpoint

# Of checkpoints.
PPO, SAC = "gaitway-ppo-2", "gaitway-sac-1"
# Names in jax.nn.
_ACTIVATIONS = ("swish", "relu", "tanh", "elu", "gelu", "leaky_relu", "selu", "sigmoid", "softplus")
_LEAST_DEVIATION = 0.001


class Parameters(NamedTuple):
    """mean, std: of observations, [observation_size], or dicts of these by the observations' names.
    layers: (kernel [inputs, outputs], bias [outputs]) of each; the last gives 2 × action_size numbers."""

    mean: Any
    std: Any
    layers: list[tuple[jax.Array, jax.Array]]


Answer = Callable[[Parameters, Any, jax.Array], jax.Array]
Activation = Callable[[jax.Array], jax.Array]


def load(form: str, content: bytes, is_checkpoint: bool, deterministic: bool) -> tuple[Parameters, Answer]:
    """The parameters, and (parameters, observation [..., observation_size], key) -> action [..., action_size]
    in [-1, 1]. Raises PolicyUnreadable."""
    if is_checkpoint:
        facts, state = checkpoint.read(content, form)
        normalizer, policy = state["normalizer"], state["params"]["policy"]
    else:
        normalizer, policy, facts = brax_file.read(content)
    activation = activation_of(facts.get("activation", "swish"))
    seen = facts.get("policy_obs_key", "state")
    bound = facts.get("normalize_observations_max_abs_value")

    def answer(parameters: Parameters, observation: Any, key: jax.Array) -> jax.Array:
        mean, std, layers = parameters
        if isinstance(observation, Mapping):
            observation, mean, std = observation[seen], mean[seen], std[seen]
        output = network(layers, normalized(observation, mean, std, bound), activation)
        location, scale = jnp.split(output, 2, axis=-1)
        if not deterministic:
            deviation = jax.nn.softplus(scale) + _LEAST_DEVIATION
            location = jax.random.normal(key, location.shape) * deviation + location
        return jnp.tanh(location)

    return Parameters(normalizer["mean"], normalizer["std"], layers_of(policy)), answer


def activation_of(name: str) -> Activation:
    """The function of this name in jax.nn. Raises PolicyUnreadable for one that is not known."""
    if name not in _ACTIVATIONS:
        raise PolicyUnreadable(f"This version of gaitway has no activation function {name!r}.")
    return getattr(jax.nn, name)


def layers_of(network: Any) -> list[tuple[jax.Array, jax.Array]]:
    """(kernel, bias) of each layer, from Brax's parameters."""
    layers = [network["params"][f"hidden_{i}"] for i in range(len(network["params"]))]
    return [(layer["kernel"], layer["bias"]) for layer in layers]


def normalized(observation: jax.Array, mean: Any, std: Any, bound: float | None) -> jax.Array:
    """Deviations from the mean, in standard deviations; whole numbers stay as they are, as in Brax."""
    if not jnp.issubdtype(observation.dtype, jnp.inexact):
        return observation
    deviations = (observation - mean) / std
    return deviations if bound is None else jnp.clip(deviations, -bound, bound)


def network(
    layers: list[tuple[jax.Array, jax.Array]], values: jax.Array, activation: Activation
) -> jax.Array:
    """What a multilayer perceptron puts out."""
    for kernel, bias in layers[:-1]:
        values = activation(values @ kernel + bias)
    kernel, bias = layers[-1]
    return values @ kernel + bias
