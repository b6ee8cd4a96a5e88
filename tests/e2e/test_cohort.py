"""A sweep whose trials are trained together goes through the whole service: on a GPU, and on a CPU."""

from collections.abc import Iterator
from typing import Any

import pytest

from gaitway.client import Client
from tests.e2e.accelerators import ACCELERATORS, TINY, use
from tests.e2e.conftest import serving

_ALGORITHMS: dict[str, dict[str, Any]] = {
    "cpu": {**TINY, "num_timesteps": 320, "num_evals": 2, "num_eval_envs": 2},
    "gpu": {"num_timesteps": 2_000_000},
}


@pytest.fixture(params=ACCELERATORS)
def accelerator(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The kind of device that the worker has. On a GPU, trials train together by default."""
    use(request.param, monkeypatch)
    if request.param == "cpu":
        monkeypatch.setenv("GAITWAY_COHORT", "4")
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
    (worker,) = client.workers()
    for one in jobs:
        assert one.succeeded, one.message
        (attempt,) = one.attempts
        assert attempt.details["trained_together"] == 4
        assert attempt.worker == worker.name
        assert one.progress.step == one.progress.total >= algorithm["num_timesteps"]
    newest = [client.checkpoints(one.id)[-1] for one in jobs]
    assert [checkpoint.step for checkpoint in newest] == [one.progress.step for one in jobs]
    for one in jobs:
        returns = [row.values.get("eval/episode_reward") for row in client.metrics(one.id)]
        best = one.newest("best_policy")
        assert best is not None
        assert best.metadata == {"return": max(found for found in returns if found is not None)}
    assert len({best.sha256 for one in jobs if (best := one.newest("best_policy"))}) == 4
