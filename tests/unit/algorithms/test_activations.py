"""The activations of a policy's layers: their names, and that they are what the policy acts by."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.activations import ActivationReader
from core.algorithms.catalog import ALGORITHMS
from core.algorithms.ppo.networks import acting, make_networks
from core.algorithms.ppo.policy import load
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.sac.spec import SACSpec
from core.algorithms.trained_policy import load_policy
from tests.exports import Numbers, jax_answers, policy_file

NETWORK: dict[str, Any] = {
    "kind": "intention",
    "latent": 3,
    "encoder": [6, 4],
    "decoder": [7],
    "places": [[3, 1], [0, 2]],
}
SEEN = np.random.default_rng(0).normal(1, 2, (1001, 5)).astype(np.float32)
KEYS = np.asarray(jax.random.split(jax.random.PRNGKey(1), len(SEEN)))


def reader_of(settings: PPOSpec | SACSpec) -> ActivationReader:
    content = policy_file(settings, SEEN, 2)
    policy = load_policy(content, settings.algorithm(), is_checkpoint=False)
    assert policy.activations is not None
    return policy.activations()


@pytest.mark.parametrize(
    "settings",
    [
        PPOSpec.model_validate({"policy_hidden_layer_sizes": [8, 4]}),
        PPOSpec.model_validate({"network": NETWORK, "normalize_observations_max_abs_value": 2.0}),
        SACSpec.model_validate({"policy_hidden_layer_sizes": [8], "activation": "relu"}),
    ],
    ids=["ppo", "intention", "sac"],
)
def test_the_last_layer_gives_the_action_and_the_catalog_knows_each(settings: PPOSpec | SACSpec) -> None:
    reader = reader_of(settings)
    known = ALGORITHMS[settings.algorithm()].layers(settings, 2)
    assert [*reader.sizes.items()] == [*known.items()]
    found = reader.read(SEEN, KEYS, list(known))
    assert {name: values.shape for name, values in found.items()} == {
        name: (1001, size) for name, size in known.items()
    }
    location: Numbers = found[list(known)[-1]][:, :2]
    expected = jax_answers(settings.algorithm(), policy_file(settings, SEEN, 2), SEEN)
    np.testing.assert_allclose(np.tanh(location), expected, rtol=0, atol=1e-5)


def test_only_the_chosen_layers_are_read() -> None:
    reader = reader_of(PPOSpec.model_validate({"network": NETWORK}))
    assert set(reader.read(SEEN[:3], KEYS[:3], ["latent/mean", "encoder/1"])) == {"latent/mean", "encoder/1"}


def test_an_intention_is_sampled_with_the_noise_of_the_action_or_is_its_mean() -> None:
    settings = PPOSpec.model_validate({"network": NETWORK})
    content = policy_file(settings, SEEN, 2)
    names = ["latent/mean", "latent/std", "latent/sample"]
    for deterministic in (True, False):
        policy = load(content, is_checkpoint=False, deterministic=deterministic)
        assert policy.activations is not None
        found = policy.activations().read(SEEN, KEYS, names)
        noise = (found["latent/sample"] - found["latent/mean"]) / found["latent/std"]
        if deterministic:
            np.testing.assert_array_equal(noise, 0)
            continue
        act = acting(make_networks(5, 2, settings), tuple(policy.parameters))
        used = jax.vmap(act)(SEEN, jnp.asarray(KEYS))[1]["latent_noise"]
        np.testing.assert_allclose(noise, used, rtol=0, atol=1e-4)
