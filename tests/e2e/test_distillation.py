"""Two trackers, one policy of both, and its decoder in another task: through the service."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.clips import archive
from gaitway.client import Client
from tests.e2e.test_clips import ALGORITHM
from tests.unit.worker.validation.test_clips import HOPS, hop

pytestmark = [pytest.mark.extra, pytest.mark.timeout(600)]

BODY = [{"kind": "joint_positions"}, {"kind": "joint_velocities"}]
NETWORK = {"kind": "intention", "latent": 4, "encoder": [32], "decoder": [32]}
TRACKER = {**ALGORITHM, "num_timesteps": 64 * 10 * 20, "normalize_observations_max_abs_value": 5.0}
STUDENT: dict[str, Any] = {
    "kind": "distillation",
    "num_timesteps": 64 * 10 * 120,
    "num_envs": 64,
    "unroll_length": 10,
    "episode_length": 50,
    "learning_rate": 3e-3,
    "num_evals": 2,
    "num_eval_envs": 4,
    "network": NETWORK,
}


def test_one_policy_learns_what_two_trackers_do(client: Client, tmp_path: Path) -> None:
    (model_file := tmp_path / "hops.xml").write_bytes(HOPS)
    model = client.add_model(model_file)
    (file := tmp_path / "hops.npz").write_bytes(archive.to_bytes([hop(), hop("stay", frames=30)]))
    clips = client.add_clips(file, model.id)

    def follows(*names: str) -> dict[str, Any]:
        reference = {"clips": [{"file": clips.id, **({"names": names} if names else {})}]}
        observation = [{"kind": "reference"}, *BODY]
        task = {"reference": reference, "reward": [{"kind": "track_joints"}], "observation": observation}
        return {"id": "mjcf", "options": {"model": model.id, **task}}

    experts = [
        client.submit(environment=follows(name), algorithm=TRACKER, video=None) for name in ("hop", "stay")
    ]
    assert all(client.wait(one.id, timeout=280).succeeded for one in experts)
    algorithm = {**STUDENT, "experts": [{"job": one.id} for one in experts]}
    video = {"width": 160, "height": 120, "seconds": 1}
    student = client.wait(
        client.submit(environment=follows(), algorithm=algorithm, video=video, battery=True).id, timeout=280
    )
    assert student.succeeded, student.message
    told = [row.values.get("training/action_error") for row in client.metrics(student.id)]
    errors = [error for error in told if error is not None]
    assert errors[-1] < errors[0] / 5
    assert {"checkpoint", "policy", "best_policy", "export", "video"} <= {
        one.role for one in student.artifacts
    }
    assert client.load_policy(student.id)(np.zeros(1)) is not None
    policy = {"kind": "checkpoint", "job": student.id}
    rolled = client.submit(
        kind="rollout", environment=follows(), policy=policy, num_steps=20, video=video, recording={}
    )
    assert client.wait(rolled.id, timeout=120).succeeded
    # Its decoder moves the body elsewhere.
    action = {"kind": "decoder", "job": student.id}
    task = {"model": model.id, "observation": BODY, "action": action, "reward": [{"kind": "alive"}]}
    moved = client.submit(environment={"id": "mjcf", "options": task}, algorithm=ALGORITHM, video=None)
    assert client.wait(moved.id, timeout=280).succeeded
