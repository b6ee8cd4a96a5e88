"""Policies that are networks behind a normaliser.

PPO's and SAC's give a normal distribution whose samples tanh bounds; DQN's value each choice of each part of
the body. Source: brax.training (running_statistics.normalize, networks.MLP,
distribution.NormalTanhDistribution).
"""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaitway import exported_policy
from gaitway.errors import PolicyUnreadable
from gaitway.policies import checkpoint

# Formats of checkpoints.
PPO, SAC, DQN = "gaitway-ppo-2", "gaitway-sac-1", "gaitway-dqn-1"
DISTILLATION = "gaitway-distillation-1"  # Its policies are as PPO's.
# Names in jax.nn.
_ACTIVATIONS = ("swish", "relu", "tanh", "elu", "gelu", "leaky_relu", "selu", "sigmoid", "softplus")
_LEAST_DEVIATION = 0.001


class Parameters(NamedTuple):
    """mean, std: of observations, [observation_size].
    layers: (kernel [inputs, outputs], bias [outputs]) of each; the last gives 2 × action_size numbers.
    encoder: of a policy that has one, its layers, whose last gives means and logarithms of deviations."""

    mean: Any
    std: Any
    layers: list[tuple[Any, Any]]
    encoder: Sequence[tuple[Any, Any]] = ()


class _Design(NamedTuple):
    """observation: the one that the policy sees, of several by name. bound: on the normalised observation.
    encoded: the numbers of it that an encoder sees."""

    activation: str
    observation: str
    bound: float | None
    encoded: tuple[int, ...] = ()


Answer = Callable[[Parameters, Any, jax.Array], jax.Array]
Activation = Callable[[jax.Array], jax.Array]


def load(form: str, content: bytes, is_checkpoint: bool, deterministic: bool) -> tuple[Parameters, Answer]:
    """The parameters, and (parameters, observation [..., observation_size], key) -> action [..., action_size]
    in [-1, 1]. content: a checkpoint of this format, or a `policy.npz`. Raises PolicyUnreadable."""
    design, parameters = _of_checkpoint(form, content) if is_checkpoint else _of_export(content)
    activation = activation_of(design.activation)

    def answer(parameters: Parameters, observation: Any, key: jax.Array) -> jax.Array:
        mean, std, layers, encoder = parameters
        if isinstance(observation, Mapping):
            observation = observation[design.observation]
        values = normalized(observation, mean, std, design.bound)
        if encoder:
            encoded = np.array(design.encoded)
            latent, log_std = jnp.split(network(encoder, values[..., encoded], activation), 2, axis=-1)
            if not deterministic:
                key, latent_key = jax.random.split(key)
                latent = latent + jnp.exp(log_std) * jax.random.normal(latent_key, latent.shape)
            values = jnp.concatenate([latent, jnp.delete(values, encoded, axis=-1)], axis=-1)
        output = network(layers, values, activation)
        location, scale = jnp.split(output, 2, axis=-1)
        if not deterministic:
            deviation = jax.nn.softplus(scale) + _LEAST_DEVIATION
            location = jax.random.normal(key, location.shape) * deviation + location
        return jnp.tanh(location)

    return parameters, answer


def load_dqn(content: bytes, is_checkpoint: bool, deterministic: bool) -> tuple[Parameters, Answer]:
    """The parameters, and (parameters, observation [..., observation_size], key) -> choices [..., num_parts]
    int32. A checkpoint and a policy file have the same names for what is read. Raises PolicyUnreadable."""
    facts, state = checkpoint.read(content, DQN)
    activation = activation_of(facts["activation"])
    shape = (facts["num_parts"], facts["num_choices"])
    bound = facts["normalize_observations_max_abs_value"] if facts["normalize_observations"] else None
    epsilon = jnp.float32(facts["epsilon"])

    def answer(parameters: Parameters, observation: Any, key: jax.Array) -> jax.Array:
        mean, std, layers, _ = parameters
        flat = network(layers, normalized(observation, mean, std, bound), activation)
        best = jnp.argmax(flat.reshape(*flat.shape[:-1], *shape), axis=-1).astype(jnp.int32)
        if deterministic:
            return best
        explore_key, choose_key = jax.random.split(key)
        explores = jax.random.uniform(explore_key, best.shape) < epsilon
        return jnp.where(explores, jax.random.randint(choose_key, best.shape, 0, shape[1]), best)

    normalizer = state["normalizer"]
    return Parameters(normalizer["mean"], normalizer["std"], layers_of(state["params"])), answer


def _of_checkpoint(form: str, content: bytes) -> tuple[_Design, Parameters]:
    facts, state = checkpoint.read(content, form)
    design = _Design(
        facts.get("activation", "swish"),
        facts.get("policy_obs_key", "state"),
        facts.get("normalize_observations_max_abs_value"),
        tuple(start + i for start, size in facts.get("encoder_places") or () for i in range(size)),
    )
    mean, std = state["normalizer"]["mean"], state["normalizer"]["std"]
    if isinstance(mean, Mapping):
        mean, std = mean[design.observation], std[design.observation]
    policy = state["params"]["policy"]
    if not design.encoded:
        return design, Parameters(mean, std, layers_of(policy))
    encoder, decoder = (layers_of({"params": policy["params"][name]}) for name in ("encoder", "decoder"))
    return design, Parameters(mean, std, decoder, encoder)


def _of_export(content: bytes) -> tuple[_Design, Parameters]:
    try:
        policy = exported_policy.load(io.BytesIO(content))
        bound = None if math.isinf(policy.max_abs) else policy.max_abs
        contract = policy.about
        design = _Design(
            contract["network"]["activation"], contract["observation"]["name"], bound, policy.encoded
        )
        return design, Parameters(policy.mean, policy.std, [*policy.layers], policy.encoder)
    except Exception as error:  # damaged bytes may make a decoder raise anything
        raise PolicyUnreadable("This is not a policy file, or it is damaged.") from error


def activation_of(name: str) -> Activation:
    """The function of this name in jax.nn. Raises PolicyUnreadable for one that is not known."""
    if name not in _ACTIVATIONS:
        raise PolicyUnreadable(f"This version of gaitway has no activation function {name!r}.")
    return getattr(jax.nn, name)


def layers_of(network: Any) -> list[tuple[Any, Any]]:
    """(kernel, bias) of each layer, from Brax's parameters."""
    layers = [network["params"][f"hidden_{i}"] for i in range(len(network["params"]))]
    return [(layer["kernel"], layer["bias"]) for layer in layers]


def normalized(observation: jax.Array, mean: Any, std: Any, bound: float | None) -> jax.Array:
    """Deviations from the mean, in standard deviations; whole numbers stay as they are, as in Brax."""
    if not jnp.issubdtype(observation.dtype, jnp.inexact):
        return observation
    deviations = (observation - mean) / std
    return deviations if bound is None else jnp.clip(deviations, -bound, bound)


def network(layers: Sequence[tuple[Any, Any]], values: jax.Array, activation: Activation) -> jax.Array:
    """The output of a multilayer perceptron."""
    for kernel, bias in layers[:-1]:
        values = activation(values @ kernel + bias)
    kernel, bias = layers[-1]
    return values @ kernel + bias
