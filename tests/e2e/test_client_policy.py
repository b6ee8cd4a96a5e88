"""A policy from the service to a function in a notebook."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.checkpoint import describe
from core.algorithms.normalizer import init_normalizer
from core.algorithms.policy_file import write_policy
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.policy import make_inference
from core.algorithms.ppo.spec import PPOSpec
from gaitway import Client, NotFound
from tests import probes
from tests.api.conftest import Attempt, Stack, job, quiet, server, stack
from tests.exports import numpy_file_of
from tests.unit.algorithms.checkpoints import pack

__all__ = ["quiet", "server", "stack"]  # fixtures

SETTINGS = PPOSpec.model_validate({"policy_hidden_layer_sizes": [8, 4], "value_hidden_layer_sizes": [6]})
OBSERVATIONS = jnp.array([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]])


def test_the_final_policy_and_that_of_a_checkpoint_act_as_they_were_trained(stack: Stack) -> None:
    networks = make_networks(3, 2, SETTINGS)
    early, final = (init_params(networks, jax.random.PRNGKey(seed)) for seed in (1, 2))
    description = describe(probes.endless(), SETTINGS) | {"observation_size": 3, "action_size": 2}
    state = {"normalizer": init_normalizer(3), "params": {"policy": early.policy, "value": early.value}}
    attempt = Attempt(stack, job())
    with Client(f"http://127.0.0.1:{stack.port}") as client:
        with pytest.raises(NotFound, match="no policy"):
            client.load_policy(attempt.id)
        attempt.keep("step-5.ckpt", pack(description, {}, state), role="checkpoint", step=5)
        first = (init_normalizer(3), early.policy, early.value)
        last = (init_normalizer(3), final.policy, final.value)

        # A running job has no final policy yet: its newest checkpoint stands in.
        acts = client.load_policy(attempt.id)(OBSERVATIONS)
        key = jax.random.PRNGKey(0)
        np.testing.assert_allclose(acts, make_inference(first)(OBSERVATIONS, key), rtol=1e-6)

        attempt.keep("policy", write_policy(last), role="policy", step=9)
        # An older policy.npz is another policy, and Brax's own file is not read.
        attempt.keep("policy.npz", b"of step 5", role="export", step=5)
        with pytest.raises(NotFound, match=r"no policy\.npz, which .*brax\.io\.model\.load_params"):
            client.load_policy(attempt.id)
        attempt.keep("policy.npz", numpy_file_of(write_policy(last)), role="export", step=9)
        act = client.load_policy(attempt.id)
        np.testing.assert_allclose(act(OBSERVATIONS), make_inference(last)(OBSERVATIONS, key), rtol=1e-6)
        assert act(OBSERVATIONS[0]).shape == (2,)
        np.testing.assert_allclose(client.load_policy(attempt.id, step=5)(OBSERVATIONS), acts)

        sampling = client.load_policy(attempt.id, deterministic=False)
        assert not np.array_equal(sampling(OBSERVATIONS, key), act(OBSERVATIONS))
        with pytest.raises(ValueError, match="random key"):
            sampling(OBSERVATIONS)
        with pytest.raises(NotFound, match="checkpoints: 5"):
            client.load_policy(attempt.id, step=6)
