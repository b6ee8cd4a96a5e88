"""A sweep whose trials are trained together goes through the whole service: on a GPU, and on a CPU."""

from collections.abc import Iterator
from typing import Any

import pytest

from gaitway.client import Client
from tests.compiling import compiling_quickly
from tests.e2e.conftest import serving

_ON_A_GPU = {"num_timesteps": 2_000_000}
_ON_A_CPU: dict[str, Any] = {
    "num_timesteps": 320,
    "num_envs": 8,
    "unroll_length": 10,
    "batch_size": 4,
    "num_minibatches": 2,
    "num_evals": 2,
    "num_eval_envs": 2,
    "episode_length": 20,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
}
_ALGORITHMS = {"cpu": _ON_A_CPU, "gpu": _ON_A_GPU}


@pytest.fixture(
    params=[pytest.param("cpu", marks=pytest.mark.slow), pytest.param("gpu", marks=pytest.mark.gpu)]
)
def accelerator(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the worker runs on."""
    monkeypatch.setenv("GAITWAY_COHORT", "4")
    if request.param == "cpu":  # Also where there is a GPU.
        for name, value in {**compiling_quickly(), "JAX_PLATFORMS": "cpu"}.items():
            monkeypatch.setenv(name, value)
    return request.param


@pytest.fixture
def client(accelerator: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with serving(tmp_path_factory.mktemp(accelerator)) as client:
        yield client


@pytest.mark.timeout(600)
def test_four_seeds_are_trained_together(accelerator: str, client: Client) -> None:
    algorithm = _ALGORITHMS[accelerator]
    job = {
        "kind": "train",
        "environment": "ant",
        "algorithm": algorithm,
        "resources": {"accelerator": accelerator},
        "video": None,
    }
    sweep = client.sweep(job=job, method="grid", parameters={"seed": [0, 1, 2, 3]})
    client.wait_for_sweep(sweep.id)
    jobs = [client.get(trial.job) for trial in client.get_sweep(sweep.id).trials]
    assert len(jobs) == 4
    for one in jobs:
        assert one.succeeded, one.message
        (attempt,) = one.attempts
        assert attempt.details["trained_together"] == 4
        assert one.progress.step == one.progress.total >= algorithm["num_timesteps"]
    newest = [client.checkpoints(one.id)[-1] for one in jobs]
    assert [checkpoint.step for checkpoint in newest] == [one.progress.step for one in jobs]
