"""DQN's policies: a normaliser, and a network that values each choice of each part of the body."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from gaitway.policies import checkpoint
from gaitway.policies.network import Parameters, activation_of, layers_of, network, normalized

_FORMAT = "gaitway-dqn-1"

Answer = Callable[[Parameters, jax.Array, jax.Array], jax.Array]


def load(content: bytes, is_checkpoint: bool, deterministic: bool) -> tuple[Parameters, Answer]:
    """The parameters, and (parameters, observation [..., observation_size], key) -> choices [..., num_parts]
    int32. A checkpoint and a policy file have the same names for what is read. Raises PolicyUnreadable."""
    facts, state = checkpoint.read(content, _FORMAT)
    activation = activation_of(facts["activation"])
    shape = (facts["num_parts"], facts["num_choices"])
    bound = facts["normalize_observations_max_abs_value"] if facts["normalize_observations"] else None
    epsilon = jnp.float32(facts["epsilon"])

    def answer(parameters: Parameters, observation: Any, key: jax.Array) -> jax.Array:
        mean, std, layers = parameters
        flat = network(layers, normalized(observation, mean, std, bound), activation)
        best = jnp.argmax(flat.reshape(*flat.shape[:-1], *shape), axis=-1).astype(jnp.int32)
        if deterministic:
            return best
        explore_key, choose_key = jax.random.split(key)
        explores = jax.random.uniform(explore_key, best.shape) < epsilon
        return jnp.where(explores, jax.random.randint(choose_key, best.shape, 0, shape[1]), best)

    normalizer = state["normalizer"]
    return Parameters(normalizer["mean"], normalizer["std"], layers_of(state["params"])), answer
