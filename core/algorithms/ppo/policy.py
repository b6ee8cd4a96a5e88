"""A trained policy: read from a checkpoint or a file, and as a function."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, cast

import jax
import jax.numpy as jnp
from flax import serialization

from core.algorithms.activations import LatentNoise
from core.algorithms.brax_training import init_normalizer
from core.algorithms.checkpoint import Format
from core.algorithms.policy_file import PolicyConfig, PolicyParams, Triple, config_of, read_policy
from core.algorithms.ppo.learner import FORMAT
from core.algorithms.ppo.networks import acting, make_networks
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.trained_policy import TrainedPolicy, of_network
from core.environments.environment import ObservationSize

Inference = Callable[[Any, jax.Array], jax.Array]


def make_inference(params: PolicyParams | Triple, *, deterministic: bool = True) -> Inference:
    """(observations [..., obs], key) -> actions [..., act] in [-1, 1]; pure, to be jitted by the caller.

    A policy that was trained on several observations takes them by name, and reads its own.
    The networks' sizes are read from the parameters. deterministic: the mode of the action's
    distribution instead of a sample; the key is then not used.
    """
    observation_size, action_size, settings = _sizes(params)
    networks = make_networks(observation_size, action_size, settings)
    policy = acting(networks, tuple(params), deterministic=deterministic)

    def act(observation: Any, key: jax.Array) -> jax.Array:
        return policy(observation, key)[0]

    return act


def load(
    content: bytes, *, is_checkpoint: bool, deterministic: bool = True, form: Format = FORMAT
) -> TrainedPolicy:
    """The policy of a checkpoint of this form or a policy file, ready to act. Raises JobFailed if it is
    damaged."""
    params = policy_from_checkpoint(content, form) if is_checkpoint else read_policy(content)

    def answer(params: PolicyParams, observation: Any, key: jax.Array) -> jax.Array:
        return make_inference(params, deterministic=deterministic)(observation, key)

    return of_network(params, answer, None if deterministic else _latent_noise(params))


def _latent_noise(params: PolicyParams) -> LatentNoise | None:
    """The noise of an encoder's intentions; None without an encoder."""
    sizes, action_size, settings = _sizes(params)
    if settings.network is None:
        return None
    policy = acting(make_networks(sizes, action_size, settings), tuple(params))
    anything: Any = jax.tree.map(jnp.zeros, sizes)  # Noise does not depend on what is seen.
    return lambda key: policy(anything, key)[1]["latent_noise"]


def policy_from_checkpoint(content: bytes, form: Format = FORMAT) -> PolicyParams:
    """The policy of a checkpoint, arrays on the host. Raises JobFailed if it is damaged."""
    header, state = form.read(content)
    template = jax.device_get(init_normalizer(header["observation_size"]))
    normalizer: Any = serialization.from_state_dict(template, state["normalizer"])
    params = state["params"]
    return PolicyParams(normalizer, params["policy"], params.get("value", {}), PolicyConfig.of(header))


def _sizes(params: PolicyParams | Triple) -> tuple[ObservationSize, int, PPOSpec]:
    """Observation size, action size, and settings with the networks that these parameters were made for."""
    normalizer, policy, value = params
    facts = asdict(config_of(params))
    if value:  # A distilled policy has none.
        facts["value_hidden_layer_sizes"] = _layers(value)[1:-1]
    if places := facts.pop("encoder_places"):
        encoder, last_layers = (
            _layers({"params": policy["params"][name]}) for name in ("encoder", "decoder")
        )
        facts["network"] = {
            "kind": "intention",
            "latent": encoder[-1] // 2,
            "encoder": encoder[1:-1],
            "decoder": last_layers[1:-1],
            "places": list(places),
        }
    else:
        last_layers = _layers(policy)
        facts["policy_hidden_layer_sizes"] = last_layers[1:-1]
    sizes: Any = jax.tree.map(lambda mean: mean.shape[-1], normalizer.mean)
    # The last layer gives a location and a scale for each component of an action.
    return sizes, last_layers[-1] // 2, PPOSpec.model_validate(facts)


def _layers(network: Any) -> list[int]:
    """Widths of a network from its input to its output."""
    layers = cast("dict[str, Any]", network["params"])
    kernels = [layers[f"hidden_{i}"]["kernel"] for i in range(len(layers))]
    return [kernels[0].shape[0], *(kernel.shape[1] for kernel in kernels)]
