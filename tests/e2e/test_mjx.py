"""A job on MJX goes through API, worker, checkpoint and video: on a GPU, MJX's place, and on a CPU."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from gaitway.client import Client
from tests.compiling import compiling_quickly
from tests.e2e.conftest import serving

# On a GPU 2.3 M steps under the tuned settings; on a CPU two updates of 8 × 10 steps.
_ON_A_GPU = {"num_timesteps": 2_300_000}
_ON_A_CPU: dict[str, Any] = {
    "num_timesteps": 160,
    "num_envs": 8,
    "unroll_length": 10,
    "batch_size": 4,
    "num_minibatches": 2,
    "num_evals": 0,
    "episode_length": 20,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
}
_ALGORITHMS = {"cpu": _ON_A_CPU, "gpu": _ON_A_GPU}


@pytest.fixture(
    scope="module",
    params=[pytest.param("cpu", marks=pytest.mark.slow), pytest.param("gpu", marks=pytest.mark.gpu)],
)
def accelerator(request: pytest.FixtureRequest) -> Iterator[str]:
    """What the worker runs on."""
    with pytest.MonkeyPatch.context() as environment:
        if request.param == "cpu":  # Also where there is a GPU. MJX's programs take minutes to compile well.
            for name, value in {**compiling_quickly(), "JAX_PLATFORMS": "cpu"}.items():
                environment.setenv(name, value)
        yield request.param


@pytest.fixture(scope="module")
def client(accelerator: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with serving(tmp_path_factory.mktemp(accelerator)) as client:
        yield client


def num_frames(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(container.streams.video[0]))


@pytest.mark.timeout(1500)
def test_a_job_on_mjx_goes_from_post_to_its_video(accelerator: str, client: Client, tmp_path: Path) -> None:
    algorithm = _ALGORITHMS[accelerator]
    submitted = client.submit(
        {
            "kind": "train",
            "environment": "half_cheetah",
            "algorithm": algorithm,
            "physics": "mjx",
            "resources": {"accelerator": accelerator},
            "video": {"width": 160, "height": 120, "seconds": 1},
        }
    )
    job = client.wait(submitted.id)
    assert job.succeeded, job.message
    (attempt,) = job.attempts
    assert attempt.engine == "mjx"
    assert attempt.device is not None
    assert attempt.device.startswith("cpu") == (accelerator == "cpu")
    assert job.progress.step == job.progress.total >= algorithm["num_timesteps"]
    assert client.checkpoints(job.id)[-1].step == job.progress.step
    assert num_frames(client.video(job.id, tmp_path / "video.mp4")) == 30
    action = client.load_policy(job.id)(np.zeros(17, np.float32))
    assert action.shape == (6,)
    assert np.isfinite(action).all()
