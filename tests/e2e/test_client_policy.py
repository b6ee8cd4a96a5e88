"""A policy from the service to a function in a notebook."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from core.algorithms.brax_training import init_normalizer
from core.algorithms.checkpoint import describe
from core.algorithms.policy_file import write_policy
from core.algorithms.ppo.networks import init_params, make_networks
from core.algorithms.ppo.policy import make_inference
from core.algorithms.ppo.spec import PPOSpec
from gaitway import Client, NotFound
from gaitway.cli.main import app
from tests import probes
from tests.api.conftest import Attempt, Stack, job, quiet, server, stack
from tests.exports import numpy_file_of
from tests.unit.algorithms.checkpoints import pack

pytestmark = pytest.mark.extra

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


def test_each_of_several_seeds_has_its_files_for_the_client_and_the_command_line(
    stack: Stack, tmp_path: Path
) -> None:
    networks, key = make_networks(3, 2, SETTINGS), jax.random.PRNGKey(0)
    attempt, wanted = Attempt(stack, job(seeds=[4, 1])), dict[int, jax.Array]()
    attempt.keep("checkpoint", b"of both", role="checkpoint", step=9)
    runner, command = CliRunner(), ["--url", f"http://127.0.0.1:{stack.port}"]
    with Client(command[1]) as client:
        with pytest.raises(NotFound, match="its checkpoints hold those of all: roll one out"):
            client.load_policy(attempt.id, seed=1)
        for seed in (4, 1):
            params = init_params(networks, jax.random.PRNGKey(seed))
            policy = (init_normalizer(3), params.policy, params.value)
            wanted[seed] = make_inference(policy)(OBSERVATIONS, key)
            for stem, role in (("policy", "policy"), ("policy-best", "best_policy")):
                own, facts = write_policy(policy), {"seed": seed, "return": 10.0 + seed}
                name = f"{stem}-seed-{seed}"
                attempt.keep(name, own, role=role, step=9, metadata=facts)
                attempt.keep(f"{name}.npz", numpy_file_of(own), role="export", step=9, metadata=facts)
            for ending, role in (("mp4", "video"), ("png", "poster")):
                body = f"{role} of {seed}".encode()
                attempt.keep(f"video-seed-{seed}.{ending}", body, role=role, metadata={"seed": seed})
        attempt.end()
        for seed, of in ((None, 4), (4, 4), (1, 1)):
            for best in (False, True):
                act = client.load_policy(attempt.id, best=best, seed=seed)
                np.testing.assert_allclose(act(OBSERVATIONS), wanted[of], rtol=1e-5)
                stem = "policy-best" if best else "policy"
                path = client.export_policy(attempt.id, "numpy", tmp_path, best=best, seed=seed)
                assert path.name == f"{stem}-seed-{of}.npz"
            assert client.video(attempt.id, tmp_path, seed=seed).read_bytes() == b"video of %d" % of
            assert client.poster(attempt.id, tmp_path, seed=seed).read_bytes() == b"poster of %d" % of
        with pytest.raises(NotFound, match="has no seed 3; it has 4, 1"):
            client.video(attempt.id, tmp_path, seed=3)

    film = tmp_path / "film.mp4"
    answer = runner.invoke(app, [*command, "video", attempt.id, "--seed", "1", "--output", str(film)])
    assert (answer.exit_code, film.read_bytes()) == (0, b"video of 1"), answer.output
    answer = runner.invoke(
        app, [*command, "export", attempt.id, "--format", "numpy", "--seed", "1", "-o", str(tmp_path)]
    )
    assert answer.output.strip().endswith("policy-seed-1.npz")
    shown = runner.invoke(app, [*command, "show", attempt.id]).output
    assert "return 14 at step 9 (policy-best-seed-4), return 11 at step 9 (policy-best-seed-1)" in shown
    rolled = runner.invoke(app, [*command, "rollout", attempt.id, "--policy-seed", "1", "--json"])
    assert json.loads(rolled.stdout)["spec"]["policy"] == {
        "kind": "checkpoint",
        "job": attempt.id,
        "seed": 1,
    }
    for seeds in (["--seeds", "0,2,5"], ["--set", "seeds=[0,2,5]"]):
        sent = runner.invoke(app, [*command, "submit", "ant", *seeds, "--json"])
        assert json.loads(sent.stdout)["spec"]["seeds"] == [0, 2, 5]
