"""Policies with random numbers, and what their exported files answer beside JAX."""

import io
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
import numpy as np
import pytest
from numpy.typing import NDArray

from core.algorithms.brax_training import init_normalizer
from core.algorithms.export.contract import PolicyOrigin, contract
from core.algorithms.export.network import PolicyNetwork, network_of
from core.algorithms.export.numpy_file import numpy_file
from core.algorithms.export.onnx_file import onnx_file
from core.algorithms.policy_file import PolicyConfig, PolicyParams, write_policy
from core.algorithms.ppo.policy import make_inference as ppo_inference
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sac.policy import make_inference as sac_inference
from core.algorithms.sac.spec import SACSpec
from core.algorithms.trained_policy import load_policy
from gaitway import exported_policy

Numbers = NDArray[np.float32]

ORIGIN = PolicyOrigin("ppo", "ant", {"gravity": 9.81}, step_s=0.05, trained_steps=3)


def policy_file(settings: PPOSpec | SACSpec, seen: Any, action_size: int) -> bytes:
    """The file of a policy whose network is random and whose normaliser knows these observations: [N, size],
    or several by name."""
    by_name = seen if isinstance(seen, dict) else {"state": seen}
    places = {"encoder_places": getattr(settings, "encoder_places", None)}  # PPO's alone.
    config = PolicyConfig.of(settings.model_dump() | places)
    own = by_name[config.policy_obs_key]
    normalizer = init_normalizer(jax.tree.map(lambda values: values.shape[-1], seen))
    if settings.normalize_observations:
        mean = jax.tree.map(lambda values: np.mean(values, axis=0, dtype=np.float32), seen)
        # Brax bounds deviations from below, too.
        std = jax.tree.map(lambda values: np.maximum(np.std(values, axis=0), np.float32(1e-6)), seen)
        normalizer = normalizer.replace(mean=mean, std=std)
    policy = _random_policy(settings, own.shape[-1], action_size)
    # PPO's inference reads the sizes of the value network.
    value = _random_network([by_name[config.value_obs_key].shape[-1], 1, 1])
    return write_policy(PolicyParams(normalizer, policy, value, config))


def _random_policy(settings: PPOSpec | SACSpec, observation_size: int, action_size: int) -> Any:
    network = settings.network if isinstance(settings, PPOSpec) else None
    if network is None:
        return _random_network([observation_size, *settings.policy_hidden_layer_sizes, 2 * action_size])
    seen = sum(size for _, size in network.places or ())
    encoder = _random_network([seen, *network.encoder, 2 * network.latent])
    decoder = _random_network([network.latent + observation_size - seen, *network.decoder, 2 * action_size])
    return {"params": {"encoder": encoder["params"], "decoder": decoder["params"]}}


def _random_network(sizes: Sequence[int]) -> Any:
    """Brax's parameters of layers with these widths, as large as a fresh network's."""
    draw = np.random.default_rng(3)
    layers = {
        f"hidden_{number}": {
            "kernel": draw.normal(0, inputs**-0.5, (inputs, outputs)).astype(np.float32),
            "bias": draw.normal(0, 0.1, outputs).astype(np.float32),
        }
        for number, (inputs, outputs) in enumerate(pairwise(sizes))
    }
    return {"params": layers}


def files(network: PolicyNetwork, origin: PolicyOrigin = ORIGIN) -> tuple[bytes, bytes]:
    """Those for NumPy and ONNX."""
    about = contract(network, origin)
    return numpy_file(network, about), onnx_file(network, about)


def numpy_file_of(policy: bytes) -> bytes:
    """The `policy.npz` of a policy file of PPO or SAC."""
    network = network_of(policy)
    return numpy_file(network, contract(network, ORIGIN))


def numpy_answers(content: bytes, observations: Any) -> Numbers:
    return exported_policy.load(io.BytesIO(content))(observations)


def onnx_answers(content: bytes, observations: Numbers) -> Numbers:
    onnxruntime = pytest.importorskip("onnxruntime", reason="ONNX Runtime has no wheel for this Python")
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    [answers] = session.run(["action"], {"observation": observations})
    return np.asarray(answers)


def jax_answers(algorithm: str, content: bytes, observations: Any) -> Numbers:
    """The service's own, as videos and rollouts have them."""
    make: Any = {"ppo": ppo_inference, "sac": sac_inference}[algorithm]
    parameters = load_policy(content, algorithm, is_checkpoint=False).parameters
    act = jax.jit(lambda parameters, seen: make(parameters)(seen, jax.random.key(0)))
    return np.asarray(act(parameters, observations))


def assert_acts_as_in_jax(settings: PPOSpec | SACSpec, seen: Any, action_size: int) -> None:
    """Both files give JAX's actions to 1e-5 for these observations, with a network of these settings."""
    content = policy_file(settings, seen, action_size)
    network = network_of(content)
    expected = jax_answers(settings.algorithm(), content, seen)
    assert np.ptp(expected, axis=0).min() > 1e-3, "the actions must depend on what is seen"
    for_numpy, for_onnx = files(network)
    own = seen[network.observation_name] if isinstance(seen, dict) else seen
    np.testing.assert_allclose(numpy_answers(for_numpy, seen), expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(onnx_answers(for_onnx, own), expected, rtol=0, atol=1e-5)
