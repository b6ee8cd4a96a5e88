"""A trained policy: read from a checkpoint, written to a file that Brax reads, and as a function."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
from flax import serialization

from core.algorithms import policy_file
from core.algorithms.brax_training import init_normalizer, normalization
from core.algorithms.checkpoint import Format
from core.algorithms.policy_file import PolicyConfig, PolicyParams
from core.algorithms.sac.networks import make_networks
from core.algorithms.sac.spec import SACSpec
from core.algorithms.trained_policy import TrainedPolicy, of_network

FORMAT = Format("gaitway-sac-1")

Inference = Callable[[Any, jax.Array], jax.Array]


def write_policy(normalizer: Any, policy: Any, header: Mapping[str, Any]) -> bytes:
    """The file that `brax.io.model.load_params` reads; Brax's SAC takes the first two of its three parts."""
    return policy_file.write_policy(PolicyParams(normalizer, policy, {}, PolicyConfig.of(header)))


def make_inference(params: PolicyParams, *, deterministic: bool = True) -> Inference:
    """(observations [..., obs], key) -> actions [..., act] in [-1, 1]; pure, to be jitted by the caller.

    The network's sizes are read from the parameters. deterministic: the mode of the action's distribution
    instead of a sample; the key is then not used.
    """
    layers = params.policy["params"]
    sizes = [layers[f"hidden_{i}"]["kernel"].shape for i in range(len(layers))]
    settings = SACSpec.model_validate(
        {
            "policy_hidden_layer_sizes": [size[1] for size in sizes[:-1]],
            "activation": params.config.activation,
        }
    )
    networks = make_networks(sizes[0][0], sizes[-1][1] // 2, settings)

    bounded = normalization(params.config.normalize_observations_max_abs_value)

    def normalize(observation: Any) -> Any:
        return bounded(observation, params.normalizer)

    policy = networks.acting(params.policy, normalize, deterministic=deterministic)

    def act(observation: Any, key: jax.Array) -> jax.Array:
        return policy(observation, key)[0]

    return act


def load(content: bytes, *, is_checkpoint: bool, deterministic: bool = True) -> TrainedPolicy:
    """The policy of a checkpoint or a policy file, ready to act. Raises JobFailed if it is damaged."""
    params = _from_checkpoint(content) if is_checkpoint else policy_file.read_policy(content)

    def answer(params: PolicyParams, observation: Any, key: jax.Array) -> jax.Array:
        return make_inference(params, deterministic=deterministic)(observation, key)

    return of_network(params, answer)


def _from_checkpoint(content: bytes) -> PolicyParams:
    header, state = FORMAT.read(content)
    template = jax.device_get(init_normalizer(header["observation_size"]))
    normalizer: Any = serialization.from_state_dict(template, state["normalizer"])
    return PolicyParams(normalizer, state["params"]["policy"], {}, PolicyConfig.of(header))
