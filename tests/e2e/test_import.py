"""A run comes back from its export, and its training continues to the same bits."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.environments import trajectory
from gaitway.client import Client
from gaitway.schema import JobView
from tests.e2e.test_pipeline import SMALL, rolled_out

pytestmark = pytest.mark.extra


def trained(client: Client, num_timesteps: int, **more: Any) -> JobView:
    """A finished training of updates of 640 steps."""
    brief = {**SMALL, "checkpoints": {}, "video": None, **more}
    brief["algorithm"] = {**SMALL["algorithm"], "num_timesteps": num_timesteps}
    job = client.wait(client.submit(brief).id, timeout=110)
    assert job.succeeded, job.message
    return job


def final_checkpoint(job: JobView) -> tuple[int | None, str]:
    found = job.newest("checkpoint")
    assert found is not None
    return found.step, found.sha256


@pytest.mark.timeout(300)
def test_a_training_continues_from_its_import_to_the_same_bits(quick_client: Client, tmp_path: Path) -> None:
    original = trained(quick_client, 6400, name="from here", labels={"project": "gaits"})
    undisturbed = trained(quick_client, 12_800, resume_from={"job": original.id})
    archive = quick_client.export(original.id, tmp_path)
    metrics, log = quick_client.metrics(original.id), list(quick_client.logs(original.id))
    seen = np.full((3, 4), 0.1, np.float32)
    actions = quick_client.load_policy(original.id)(seen)
    quick_client.delete(original.id)  # From here on, the export is all that is left of it.

    imported = quick_client.import_job(archive)
    assert (imported.name, imported.labels, imported.status) == (
        "from here",
        {"project": "gaits"},
        "succeeded",
    )
    assert imported.imported_from is not None
    assert imported.imported_from.job == original.id != imported.id
    assert quick_client.metrics(imported.id) == metrics
    assert list(quick_client.logs(imported.id)) == log
    np.testing.assert_array_equal(quick_client.load_policy(imported.id)(seen), actions)

    resumed = trained(quick_client, 12_800, resume_from={"job": imported.id})
    assert resumed.attempts[0].details["resumed_at_step"] == 6400
    assert final_checkpoint(resumed) == final_checkpoint(undisturbed)
    shown = rolled_out(quick_client, imported, num_steps=20, num_episodes=2, video=None)
    path = quick_client.download(shown.id, "trajectory.npz", tmp_path / "trajectory.npz")
    assert [episode.num_steps for episode in trajectory.load(path).episodes] == [20, 20]
