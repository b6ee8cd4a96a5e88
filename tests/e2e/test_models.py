"""A body that a user brings, with real parts: from its file to its video."""

from pathlib import Path

import numpy as np
import pytest

from gaitway.client import Client
from gaitway.errors import Rejected
from tests.unit.environments.mjcf.probe import XML
from tests.unit.environments.mjcf.test_archive import zipped

pytestmark = pytest.mark.extra

# A tetrahedron; MuJoCo wants a mesh to have a volume.
MESH = b"v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
ASSET = b'<asset><mesh name="hat" file="hat.obj"/></asset><worldbody>'
HAT = b'<geom type="mesh" mesh="hat" mass="0.1" contype="0" conaffinity="0"/><site name="middle"/>'
WITH_MESH = XML.replace(b"<worldbody>", ASSET).replace(b'<site name="middle"/>', HAT)
TERMS = {
    "reward": [
        {"kind": "upright", "body": "ball", "weight": 0.5},
        {"kind": "contact", "geoms": ["sphere"], "weight": -1.0, "name": "fallen"},
        {"kind": "energy", "weight": 0.01},
    ],
    "observation": [{"kind": "qpos"}, {"kind": "qvel"}, {"kind": "sensors"}],
    "termination": [{"kind": "height_range", "range": [0.2, 2.0]}],
}
VIDEO = {"camera": "above", "width": 160, "height": 120, "seconds": 0.5}


@pytest.fixture(scope="module")
def hat(client: Client, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The id of the ball with a hat, sent as a zip."""
    file = tmp_path_factory.mktemp("hat") / "ball.zip"
    file.write_bytes(zipped({"ball/model.xml": WITH_MESH, "ball/hat.obj": MESH}))
    model = client.add_model(file, timeout=60)
    assert model.status == "ready"
    assert model.description is not None
    assert model.description["inventory"]["root"] == "ball"
    return model.id


def test_a_body_that_nothing_moves_is_refused_and_the_service_goes_on(client: Client, tmp_path: Path) -> None:
    file = tmp_path / "ball.xml"
    file.write_bytes(b'<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(Rejected, match="no actuators"):
        client.add_model(file, timeout=60)
    (worker,) = client.workers()
    assert worker.job is None


def test_a_body_is_looked_at(client: Client, hat: str, tmp_path: Path) -> None:
    # A refusal that came after the API stopped waiting for it is listed too, for a day.
    assert [found.id for found in client.models() if found.status == "ready"] == [hat]
    stills = client.preview("mjcf", tmp_path, options={"model": hat}, size=(64, 48))
    assert [file.read_bytes()[:4] for file in stills.values()] == [b"\x89PNG", b"\x89PNG"]


def test_a_body_earns_what_its_terms_say_and_is_shown(client: Client, hat: str, tmp_path: Path) -> None:
    job = client.wait(
        client.submit(
            kind="rollout",
            environment={"id": "mjcf", "options": {"model": hat, **TERMS}},
            policy={"kind": "random"},
            num_steps=10,
            video=VIDEO,
        ).id,
        timeout=110,
    )
    assert job.succeeded, job.message
    assert job.newest("video") is not None
    with np.load(client.download(job.id, "trajectory.npz", tmp_path)) as shown:
        earned = {term: shown[f"episode_0/metrics/reward_{term}"] for term in ("upright", "fallen", "energy")}
        np.testing.assert_allclose(sum(earned.values()), shown["episode_0/reward"], atol=1e-5)
    assert earned["energy"].max() < 0.0


@pytest.mark.slow  # as above, and an update is compiled
@pytest.mark.timeout(300)
def test_a_policy_is_trained_in_it_and_each_term_is_measured(client: Client, hat: str) -> None:
    algorithm = {
        "num_timesteps": 1280,
        "num_envs": 64,
        "unroll_length": 10,
        "batch_size": 16,
        "num_minibatches": 4,
        "num_evals": 2,
        "num_eval_envs": 4,
        "episode_length": 50,
        "policy_hidden_layer_sizes": [16],
        "value_hidden_layer_sizes": [16],
    }
    environment = {"id": "mjcf", "options": {"model": hat, **TERMS}}
    job = client.wait(
        client.submit(environment=environment, algorithm=algorithm, video=VIDEO).id, timeout=290
    )
    assert job.succeeded, job.message
    names = {name for row in client.metrics(job.id) for name in row.values}
    assert {f"eval/episode_reward_{term}" for term in ("upright", "fallen", "energy")} <= names


def test_a_body_goes_when_it_is_told_to(client: Client, hat: str) -> None:
    client.delete_model(hat)
    assert hat not in [found.id for found in client.models()]
