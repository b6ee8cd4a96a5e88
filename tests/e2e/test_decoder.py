"""From clips of a rat to a rat that runs through a corridor by what it learnt of them, with real parts."""

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitway import exported_policy
from gaitway.client import Client
from gaitway.errors import Conflict
from gaitway.schema import JobView
from tests.unit.environments.test_imitating_bodies import FILE, at_rest

pytestmark = [pytest.mark.extra, pytest.mark.timeout(600)]  # It compiles three updates.

# Updates of 16 × 5 = 80 steps.
ALGORITHM: dict[str, Any] = {
    "num_timesteps": 400,
    "num_envs": 16,
    "unroll_length": 5,
    "batch_size": 16,
    "num_minibatches": 1,
    "num_updates_per_batch": 1,
    "num_evals": 0,
    "episode_length": 20,
    "reset_pool_size": 16,
    "value_hidden_layer_sizes": [16],
}
NETWORK = {"kind": "intention", "latent": 4, "encoder": [16], "decoder": [16]}


def until_checkpoint(client: Client, job: JobView) -> int:
    """The id of the job's training process, once it has kept a checkpoint."""
    pid = 0
    for event in client.events(job.id):
        if event.kind == "phase" and event.data["name"] == "process":
            pid = int(event.data["pid"])
        if event.kind == "artifact" and event.data["role"] == "checkpoint":
            break
    return pid


def test_a_rat_runs_a_corridor_by_the_decoder_of_its_tracker(client: Client, tmp_path: Path) -> None:
    file = at_rest("rodent", tmp_path / "clips.npz")[FILE]
    clips = client.add_clips(file, "rodent")
    reference = {"clips": [{"file": clips.id}]}
    tracker = client.submit(
        environment={"id": "rodent", "options": {"task": "imitate", "reference": reference}},
        algorithm={**ALGORITHM, "network": NETWORK},
        physics="native",
        video=None,
        battery={"starts": 1},
    )
    tracker = client.wait(tracker.id, timeout=300)
    assert tracker.succeeded, tracker.message
    assert [one["clip"] for one in client.battery(tracker.id)["clips"]] == ["rest"]
    assert "battery/reached" in tracker.progress.metrics  # A sweep may choose by it.

    action = {"kind": "decoder", "job": tracker.id}
    runner: dict[str, Any] = {
        "environment": {"id": "corridor", "options": {"walker": "rodent", "action": action}},
        "algorithm": {**ALGORITHM, "num_timesteps": 8000, "policy_hidden_layer_sizes": [16]},
        "checkpoints": {"every_steps": 800, "keep": 100},
        "physics": "native",
        "video": None,
    }
    disturbed, undisturbed = client.submit(**runner), client.submit(**runner)
    with pytest.raises(Conflict, match="unfinished jobs need"):
        client.delete(tracker.id)
    os.kill(until_checkpoint(client, disturbed), signal.SIGKILL)
    disturbed, undisturbed = (client.wait(job.id, timeout=300) for job in (disturbed, undisturbed))
    assert [attempt.reason for attempt in disturbed.attempts] == ["training_killed", "completed"]
    assert disturbed.attempts[1].details["resumed_at_step"] > 0
    [one, other] = (job.newest("checkpoint") for job in (disturbed, undisturbed))
    assert one is not None
    assert other is not None
    assert (one.step, one.sha256) == (8000, other.sha256)

    film = {"width": 160, "height": 120, "seconds": 0.5}
    policy = {"kind": "checkpoint", "job": disturbed.id}
    rollout = client.submit(kind="rollout", policy=policy, num_steps=20, video=film)
    rollout = client.wait(rollout.id, timeout=200)
    assert rollout.succeeded, rollout.message
    assert client.video(rollout.id, tmp_path / "video.mp4").stat().st_size > 1000

    act = exported_policy.load(client.export_policy(disturbed.id, "numpy", tmp_path))
    # A rat in a corridor shows 145 numbers, and a decoder of it sees 219.
    seen = np.random.default_rng(0).normal(0, 0.3, (10, 145 + 219)).astype(np.float32)
    assert act(seen).shape == (10, NETWORK["latent"])
    np.testing.assert_allclose(act(seen), client.load_policy(disturbed.id)(seen), rtol=0, atol=1e-5)
