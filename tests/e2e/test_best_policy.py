"""A training whose return falls as it learns: the policy of its best evaluation stays and can be chosen."""

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from gaitway import exported_policy
from gaitway.cli.main import app
from gaitway.client import Client
from gaitway.errors import NotReady
from gaitway.schema import ArtifactView, JobView

# A sled on a slope, without gravity. Up to 4 m/s; after 0.5 m of height the episode ends.
SLED = b"""<mujoco><option gravity="0 0 0" timestep="0.01"/><worldbody><body name="sled" pos="0 0 1">
  <joint name="slope" type="slide" axis="1 0 1" damping="1"/><geom size=".1" mass=".1"/></body></worldbody>
  <actuator><motor joint="slope" gear="4" ctrlrange="-1 1"/></actuator></mujoco>"""
# Who looks no step ahead learns to be fast, and thereby loses all the later steps of being there. Updates of
# 32 × 10 = 320 steps.
SHORT_SIGHTED: dict[str, Any] = {
    "num_timesteps": 128_000,
    "num_envs": 32,
    "unroll_length": 10,
    "batch_size": 32,
    "num_minibatches": 4,
    "learning_rate": 3e-3,
    "discounting": 0.01,
    "gae_lambda": 0.0,
    "entropy_cost": 0.0,
    "num_evals": 20,
    "num_eval_envs": 8,
    "episode_length": 100,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
}
RETURN = "eval/episode_reward"

# Its three processes and the trial of the model take a busy machine longer than the usual 120 s.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def spec(quick_client: Client, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    file = tmp_path_factory.mktemp("sled") / "sled.xml"
    file.write_bytes(SLED)
    options = {
        "model": quick_client.add_model(file, timeout=200).id,
        "n_frames": 2,
        "reward": [{"kind": "alive"}, {"kind": "forward_velocity", "weight": 0.1}],
        "termination": [{"kind": "height_range", "range": [0.5, 1.5]}],
    }
    return {
        "kind": "train",
        "environment": {"id": "mjcf", "options": options},
        "algorithm": SHORT_SIGHTED,
        "checkpoints": {"every_steps": 9_600},
        "video": None,
        "seed": 1,
    }


@dataclass(frozen=True)
class Fallen:
    """A training that was killed in the middle. before: its best policy at that moment."""

    job: JobView
    before: ArtifactView


@pytest.fixture(scope="module")
def fallen(quick_client: Client, spec: dict[str, Any]) -> Fallen:
    job = quick_client.submit(spec)
    pid = None
    for event in quick_client.events(job.id):
        if event.kind == "phase" and "pid" in event.data:
            pid = event.data["pid"]
        # By then the evaluations are past their best.
        if event.kind == "artifact" and event.data["role"] == "checkpoint" and event.data["step"] >= 19_200:
            break
    assert pid is not None
    before = quick_client.get(job.id).newest("best_policy")
    assert before is not None
    with pytest.raises(NotReady):
        quick_client.export_policy(job.id, "numpy", best=True)
    os.kill(pid, signal.SIGKILL)
    ended = quick_client.wait(job.id, timeout=250)
    assert [attempt.reason for attempt in ended.attempts] == ["training_killed", "completed"]
    return Fallen(ended, before)


def returns(client: Client, job: JobView) -> dict[int, float]:
    """By step of each evaluation."""
    rows = client.metrics(job.id)
    return {row.step: row.values[RETURN] for row in rows if RETURN in row.values}


def test_the_best_evaluations_policy_is_kept_beside_the_last_over_all_attempts(
    quick_client: Client, fallen: Fallen
) -> None:
    found, job = returns(quick_client, fallen.job), fallen.job
    best, last = job.newest("best_policy"), job.newest("policy")
    assert best == fallen.before
    assert best.step is not None
    assert last is not None
    assert last.step == job.progress.step > best.step
    assert best.metadata == {"return": max(found.values())}
    assert found[best.step] == max(found.values()) > 1.2 * found[last.step]
    shown = CliRunner().invoke(app, ["--url", quick_client.base_url, "show", job.id]).output
    assert f"return {max(found.values()):g} at step {best.step:,} (policy-best)" in shown


def test_it_can_be_rolled_out_loaded_and_exported(
    quick_client: Client, fallen: Fallen, tmp_path: Path
) -> None:
    job, found = fallen.job, returns(quick_client, fallen.job)
    command = ["--url", quick_client.base_url, "rollout", job.id, "--best", "--no-video"]
    runner = CliRunner()
    answer = runner.invoke(app, [*command, "--episodes", "4", "--num-steps", "100", "--json"])
    assert answer.exit_code == 0, answer.output
    shown = quick_client.wait(json.loads(answer.stdout)["id"], timeout=250)
    assert shown.succeeded, shown.message
    assert shown.spec["policy"] == {"kind": "checkpoint", "job": job.id, "which": "best"}
    summary = httpx.get(f"{quick_client.base_url}/jobs/{shown.id}/artifacts/summary.json").json()
    best, last = max(found.values()), found[job.progress.step]
    assert abs(summary["mean"]["return"] - best) < abs(summary["mean"]["return"] - last)

    seen = np.random.default_rng(0).normal(0, 0.3, (50, 2)).astype(np.float32)
    act = quick_client.load_policy(job.id, best=True)
    assert np.abs(act(seen) - quick_client.load_policy(job.id)(seen)).max() > 0.05
    command = ["--url", quick_client.base_url, "export", job.id, "--best", "--format", "numpy"]
    answer = runner.invoke(app, [*command, "--output", str(tmp_path)])
    assert answer.exit_code == 0, answer.output
    exported = exported_policy.load(tmp_path / "policy-best.npz")
    np.testing.assert_allclose(exported(seen), act(seen), atol=1e-5)
    assert quick_client.export_policy(job.id, "onnx", tmp_path, best=True).name == "policy-best.onnx"
