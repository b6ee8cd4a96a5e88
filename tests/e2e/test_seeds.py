"""A training of several seeds by the whole service, whose process is killed on the way."""

import json
import os
import signal
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from gaitway import exported_policy
from gaitway.client import Client
from gaitway.schema.jobs import JobView

# Updates of 64 × 10 = 640 steps.
SPEC: dict[str, Any] = {
    "kind": "train",
    "environment": "inverted_pendulum",
    "algorithm": {
        "num_timesteps": 192_000,
        "num_envs": 64,
        "unroll_length": 10,
        "batch_size": 16,
        "num_minibatches": 4,
        "num_evals": 2,
        "num_eval_envs": 4,
        "episode_length": 100,
        "policy_hidden_layer_sizes": [16],
        "value_hidden_layer_sizes": [16],
    },
    "checkpoints": {"every_steps": 38_400, "keep": 100},
    "video": {"width": 160, "height": 120, "seconds": 1},
    "seeds": [3, 0],
}
RETURN = "eval/episode_reward"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]


@pytest.fixture(scope="module")
def trained(quick_client: Client) -> JobView:
    return quick_client.wait(quick_client.submit(SPEC).id, timeout=300)


def fetched(client: Client, job: JobView, path: str, **query: Any) -> bytes:
    answer = httpx.get(f"{client.base_url}/jobs/{job.id}/{path}", params=query)
    assert answer.status_code == 200, answer.text
    return answer.content


def test_each_seed_has_its_policies_its_video_and_its_metrics(quick_client: Client, trained: JobView) -> None:
    assert trained.succeeded, trained.message
    for seed in (3, 0):
        own = {one.name for one in trained.artifacts if one.metadata.get("seed") == seed}
        assert own >= {
            *(f"policy-seed-{seed}", f"policy-seed-{seed}.npz", f"policy-seed-{seed}.onnx"),
            *(f"policy-best-seed-{seed}", f"policy-best-seed-{seed}.npz"),
            *(f"video-seed-{seed}.mp4", f"video-seed-{seed}.png", f"replay-seed-{seed}.bin"),
        }
    shared = [one.name for one in trained.artifacts if one.role in ("scene", "simulation")]
    assert sorted(shared) == ["scene.glb", "simulation.json"]
    for path, query in (("policy", {}), ("policy", {"which": "best"}), ("video", {}), ("replay", {})):
        first, second = (fetched(quick_client, trained, path, seed=seed, **query) for seed in (3, 0))
        assert first != second
        assert fetched(quick_client, trained, path, **query) == first
    [*_, last] = [row.values for row in quick_client.metrics(trained.id) if RETURN in row.values]
    own = [last[f"seed_{seed}/{RETURN}"] for seed in (3, 0)]
    assert last[RETURN] == pytest.approx(np.mean([own]))
    assert trained.progress.metrics[RETURN] == last[RETURN]
    assert not any(name.startswith("seed_") for name in trained.progress.metrics)


def test_a_killed_training_ends_in_the_same_bytes(quick_client: Client, trained: JobView) -> None:
    job = quick_client.submit(SPEC)
    pid = None
    for event in quick_client.events(job.id):
        if event.kind == "phase" and "pid" in event.data:
            pid = event.data["pid"]
        if event.kind == "artifact" and event.data["role"] == "checkpoint":
            break
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    ended = quick_client.wait(job.id, timeout=300)
    assert [attempt.reason for attempt in ended.attempts] == ["training_killed", "completed"]
    assert ended.attempts[-1].details["resumed_at_step"] > 0
    for seed in (3, 0):
        for query in ({}, {"which": "best"}):
            mine, its = (fetched(quick_client, one, "policy", seed=seed, **query) for one in (ended, trained))
            assert mine == its


def test_a_rollout_acts_by_the_seeds_policy(quick_client: Client, trained: JobView, tmp_path: Path) -> None:
    document = {"kind": "rollout", "num_steps": 20, "video": None, "seed": 5}
    found = dict[Any, Any]()
    for seed in (None, 3, 0):
        policy = {"kind": "checkpoint", "job": trained.id} | ({} if seed is None else {"seed": seed})
        shown = quick_client.wait(quick_client.submit({**document, "policy": policy}).id, timeout=300)
        assert shown.succeeded, shown.message
        found[seed] = json.loads(fetched(quick_client, shown, "artifacts/summary.json"))["mean"]
    assert found[None] == found[3] != found[0]
    (tmp_path / "policy.npz").write_bytes(fetched(quick_client, trained, "policy", seed=0, format="numpy"))
    assert exported_policy.load(tmp_path / "policy.npz").about["trained_steps"] == trained.progress.total
