"""A job on MJX goes through API, worker, checkpoint and video: on a GPU, MJX's place, and on a CPU."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from gaitway.client import Client
from tests.e2e.accelerators import ACCELERATORS, TINY, use
from tests.e2e.conftest import serving

# On a GPU 2.3 M steps under the tuned settings; on a CPU two updates.
_ALGORITHMS: dict[str, dict[str, Any]] = {
    "cpu": {**TINY, "num_timesteps": 160, "num_evals": 0},
    "gpu": {"num_timesteps": 2_300_000},
}


@pytest.fixture(scope="module", params=ACCELERATORS)
def accelerator(request: pytest.FixtureRequest) -> Iterator[str]:
    """The kind of device that the worker has."""
    with pytest.MonkeyPatch.context() as environment:
        use(request.param, environment)
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
