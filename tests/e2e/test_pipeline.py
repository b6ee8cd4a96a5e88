"""The whole service with real parts: jobs go from POST to their video, and survive what happens to them."""

import json
import os
import re
import signal
from datetime import datetime
from pathlib import Path
from typing import Any

import av
import h5py
import httpx
import jax
import numpy as np
import psutil
import pytest
from prometheus_client.parser import text_string_to_metric_families

from core.algorithms.ppo.policy import make_inference
from core.algorithms.trained_policy import load_policy
from core.environments import trajectory
from gaitway import exported_policy
from gaitway.client import Client
from gaitway.errors import NotFound
from gaitway.schema import JobView
from gaitway.views import Event
from tests.e2e.installed import Installed
from tests.e2e.watching import watching
from tests.exports import onnx_answers

# Updates of 64 × 10 = 640 steps; some ten seconds of training, so that it can be disturbed in the middle.
SMALL: dict[str, Any] = {
    "kind": "train",
    "environment": "inverted_pendulum",
    "algorithm": {
        "num_timesteps": 512_000,
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
    "checkpoints": {"every_steps": 51_200, "keep": 100},
    "video": {"width": 160, "height": 120, "seconds": 1},
    "seed": 3,
}

# The same training; what it looks like says nothing of its bits.
UNFILMED: dict[str, Any] = {**SMALL, "video": None}

URGENT: dict[str, Any] = {
    "environment": "inverted_pendulum",
    "num_steps": 10,
    "video": None,
    "priority": "high",
}

# What a training job keeps in any case.
KEPT = {
    *("checkpoint", "export", "metrics", "picture", "policy", "poster", "tensorboard", "trajectory"),
    *("video", "replay", "scene", "simulation", "best_policy"),
}

# The roles that are there already while it trains.
DURING = {"checkpoint", "export", "replay", "scene", "simulation"}


@pytest.fixture(scope="module")
def undisturbed(client: Client) -> JobView:
    """The small job, left in peace."""
    return client.wait(client.submit(SMALL).id, timeout=110)


def until_checkpoint(client: Client, job: JobView, number: int = 1) -> tuple[list[Event], int]:
    """The job's events up to its first checkpoint, or that of this number, and the training process' id."""
    seen: list[Event] = []
    for event in client.events(job.id):
        seen.append(event)
        number -= event.kind == "artifact" and event.data["role"] == "checkpoint"
        if number == 0:
            break
    pid = next(e.data["pid"] for e in seen if e.kind == "phase" and e.data["name"] == "process")
    return seen, int(pid)


def steps_of(client: Client, job: str, until: datetime) -> list[int]:
    """Those of which there were metrics by then."""
    return [e.data["step"] for e in client.events(job) if e.kind == "metrics" and e.time < until]


def rolled_out(client: Client, trained: JobView, **own: Any) -> JobView:
    """A finished rollout of what a job has learnt."""
    policy = {"kind": "checkpoint", "job": trained.id}
    common = {name: value for name, value in SMALL.items() if name not in ("algorithm", "checkpoints")}
    job = client.wait(client.submit({**common, "kind": "rollout", "policy": policy, **own}).id, timeout=110)
    assert job.succeeded, job.message
    return job


def final_checkpoint(job: JobView) -> str:
    found = job.newest("checkpoint")
    assert found is not None
    assert found.step == 512_000
    return found.sha256


def test_a_job_goes_from_post_to_its_video(client: Client, undisturbed: JobView, tmp_path: Path) -> None:
    assert (undisturbed.status, undisturbed.reason) == ("succeeded", "completed")
    assert undisturbed.progress.step == undisturbed.progress.total == 512_000
    video = client.video(undisturbed.id, tmp_path / "video.mp4")
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.width, stream.height) == ("h264", 160, 120)
        assert sum(1 for _ in container.decode(stream)) == 30
    assert {a.role for a in undisturbed.artifacts} == KEPT
    assert [a.step for a in client.checkpoints(undisturbed.id)] == [51_200 * i for i in range(1, 11)]


def test_its_policy_acts_elsewhere_as_it_does_here(
    client: Client, undisturbed: JobView, tmp_path: Path
) -> None:
    seen = np.random.default_rng(0).normal(0, 0.3, (1000, 4)).astype(np.float32)
    expected = client.load_policy(undisturbed.id)(seen)
    act = exported_policy.load(client.export_policy(undisturbed.id, "numpy", tmp_path))
    np.testing.assert_allclose(act(seen), expected, rtol=0, atol=1e-5)
    graph = client.export_policy(undisturbed.id, "onnx", tmp_path).read_bytes()
    np.testing.assert_allclose(onnx_answers(graph, seen), expected, rtol=0, atol=1e-5)
    assert act.about["environment"] == {"id": "inverted_pendulum", "options": {}}
    assert act.about["trained_steps"] == undisturbed.progress.step
    # Two steps of 0.04 s.
    assert (act.about["action"]["held_steps"], act.about["action"]["held_s"]) == (1, 0.04)


def test_the_video_is_served_in_parts(client: Client, undisturbed: JobView) -> None:
    url = f"{client.base_url}/jobs/{undisturbed.id}/video"
    whole = httpx.get(url).content
    part = httpx.get(url, headers={"Range": "bytes=4-11"})
    assert (part.status_code, part.content) == (206, whole[4:12])
    beyond = httpx.get(url, headers={"Range": f"bytes={len(whole)}-"})
    assert (beyond.status_code, beyond.headers["content-range"]) == (416, f"bytes */{len(whole)}")
    assert beyond.headers["content-type"] == "application/problem+json"


def test_what_the_attempt_found_is_in_the_record(undisturbed: JobView) -> None:
    attempt = undisturbed.attempts[0]
    assert attempt.engine == "native"
    assert attempt.details["hyperparameters"]["num_envs"] == 64
    assert attempt.details["hyperparameters"]["clipping_epsilon"] == 0.3
    assert "mujoco" in attempt.details["versions"]


def test_the_log_tells_the_story_of_a_training(client: Client, undisturbed: JobView) -> None:
    log = list(client.logs(undisturbed.id))
    told = " ".join(line.strip() for line in log)
    assert "inverted_pendulum, seed 3, ppo" in log[1]
    for said in (
        f"Attempt 1 on worker {undisturbed.attempts[0].worker}",
        "Device: cpu ×",
        "Engine: native. ",
        "mujoco 3.",
        "commit ",
        "Settings that the job names: num_timesteps=512000, num_envs=64",
        "Settings that were filled in: ",
        "Compiled in ",
        "Step 256,000: return ",
        "Checkpoint of step 51,200: ",
        "video.mp4",
        "Seconds by phase: preparing ",
        "The job has succeeded (completed). Everything asked for is done.",
    ):
        assert said in told
    assert len(log) < 60


def test_one_id_leads_from_the_request_to_the_training_process(
    client: Client, undisturbed: JobView, stack_folder: Path
) -> None:
    files = list(stack_folder.rglob("*.log"))
    lines = [line for file in files for line in file.read_text(errors="replace").splitlines()] + list(
        client.logs(undisturbed.id)
    )
    assert undisturbed.correlation_id is not None
    named = [
        json.loads(line) for line in lines if line.startswith("{") and undisturbed.correlation_id in line
    ]
    found = {(line["service"], line["event"]) for line in named}
    assert {
        ("api", "job_submitted"),
        ("api", "request_answered"),
        ("worker", "attempt_began"),
        ("worker", "attempt_ended"),
        ("training", "training_process_began"),
    } <= found


def test_what_its_worker_timed_is_told_to_prometheus(client: Client, undisturbed: JobView) -> None:
    text = httpx.get(f"{client.base_url}/metrics").text
    told = {
        sample.name: sample for family in text_string_to_metric_families(text) for sample in family.samples
    }
    assert told["gaitway_uploads_total"].value >= len(undisturbed.artifacts) - 1
    assert told["gaitway_uploaded_bytes_total"].value > 0
    phases = re.findall(r'gaitway_phase_seconds_count\{phase="(\w+)"\}', text)
    assert {"waiting", "starting", "preparing", "compiling", "training", "drawing"} <= set(phases)
    stores = set(re.findall(r'gaitway_worker_store_seconds_count\{store="(\w+)"\}', text))
    assert {"postgresql", "objects"} <= stores


def test_metrics_have_braxs_names_and_rise_in_step(client: Client, undisturbed: JobView) -> None:
    rows = client.metrics(undisturbed.id)
    steps = [row.step for row in rows]
    assert steps == sorted(steps)
    names = {name for row in rows for name in row.values}
    assert {"eval/episode_reward", "training/sps", "training/total_loss"} <= names


def test_a_rollout_of_its_policy_gives_trajectory_summary_and_video(
    client: Client, undisturbed: JobView, tmp_path: Path
) -> None:
    job = rolled_out(client, undisturbed, num_steps=40, num_episodes=2, recording=True)
    shown = trajectory.load(client.download(job.id, "trajectory.npz", tmp_path / "trajectory.npz"))
    assert [episode.num_steps for episode in shown.episodes] == [40, 40]
    summary = httpx.get(f"{client.base_url}/jobs/{job.id}/artifacts/summary.json").json()
    expected = float(np.sum(shown.episodes[1].reward))
    assert summary["episodes"][1]["return"] == pytest.approx(expected)
    assert job.newest("video") is not None
    assert job.artifact("path.png") is not None
    opened: Any = h5py.File(client.recording(job.id, tmp_path))
    with opened as recording:
        np.testing.assert_array_equal(recording["episode_1/qpos"], shown.episodes[1].qpos)
        layers = recording["episode_1/activations/policy"]
        action = np.tanh(layers[f"{len(layers) - 1}"][:, : shown.episodes[1].action.shape[1]])
        np.testing.assert_allclose(action, shown.episodes[1].action, rtol=0, atol=1e-4)


@pytest.mark.extra
def test_a_job_without_a_video_keeps_all_else(client: Client) -> None:
    # Two updates of the programs that the other jobs have compiled.
    algorithm = {**SMALL["algorithm"], "num_timesteps": 1280}
    brief = {**SMALL, "algorithm": algorithm, "checkpoints": {}, "video": None}
    job = client.wait(client.submit(brief).id, timeout=110)
    assert job.succeeded, job.message
    assert {a.role for a in job.artifacts} == KEPT - {
        *("video", "poster", "picture", "trajectory", "replay", "scene")
    }
    shown = rolled_out(client, job, num_steps=20, num_episodes=2, video=None)
    assert {"trajectory", "summary", "replay", "scene"} <= {a.role for a in shown.artifacts}
    assert shown.newest("video") is None
    with pytest.raises(NotFound, match="asks for no video: its `video` is null"):
        client.video(shown.id)


# A program of a user's, who has a module `core` of their own.
_PROGRAM = """
import json, sys
import core
import numpy as np
from gaitway import Client

client = Client(sys.argv[1])
job = client.submit(json.loads(sys.argv[2]))
job = client.wait(job.id, timeout=100)
action = client.load_policy(job.id)(np.zeros(4, np.float32))
print(json.dumps([job.id, job.status, action.tolist(), core.OWN, "brax" in sys.modules]))
"""


@pytest.mark.extra
def test_a_user_of_the_wheel_trains_on_the_service_and_loads_the_policy(
    client: Client, installed: Installed, tmp_path: Path
) -> None:
    (tmp_path / "core.py").write_text("OWN = 'a module of the user'")
    (tmp_path / "program.py").write_text(_PROGRAM)
    # Two updates of the programs that the other jobs have compiled.
    brief = {**SMALL, "algorithm": {**SMALL["algorithm"], "num_timesteps": 1280}, "checkpoints": {}}
    done = installed.python("program.py", client.base_url, json.dumps(brief), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    job_id, status, action, own_module, loads_brax = json.loads(done.stdout)
    assert (status, own_module, loads_brax) == ("succeeded", "a module of the user", False)
    content = client.download(job_id, "policy", tmp_path).read_bytes()
    policy = load_policy(content, "ppo", is_checkpoint=False)
    expected = make_inference(policy.parameters)(np.zeros(4, np.float32), jax.random.key(0))
    np.testing.assert_allclose(action, expected, rtol=1e-5)


def test_killed_stores_and_a_killed_training_process_change_nothing_in_the_result(
    client: Client, undisturbed: JobView
) -> None:
    job = client.submit(UNFILMED)
    until_checkpoint(client, job)
    (worker,) = client.workers()
    launcher = psutil.Process(worker.pid).parent()
    assert launcher is not None
    stores = {child.name(): child for child in launcher.children()}
    for name in ("postgres", "valkey-server", "weed"):
        stores[name].kill()  # The stack starts another one in its place.
    # The training goes on meanwhile, and what it has made since reaches the stores.
    _, pid = until_checkpoint(client, job, number=2)
    os.kill(pid, signal.SIGKILL)
    ended = client.wait(job.id, timeout=110)
    assert [attempt.reason for attempt in ended.attempts] == ["training_killed", "completed"]
    assert ended.attempts[1].details["resumed_at_step"] > 0
    assert final_checkpoint(ended) == final_checkpoint(undisturbed)


def test_a_training_that_makes_room_goes_on_later_and_changes_nothing_in_the_result(
    client: Client, undisturbed: JobView
) -> None:
    job = client.submit({**UNFILMED, "priority": "low"})
    until_checkpoint(client, job)
    urgent = client.submit({"kind": "rollout", "policy": {"kind": "zero"}, **URGENT})
    ended = client.wait(urgent.id, timeout=110)
    assert ended.started_at is not None
    assert (ended.started_at - urgent.created_at).total_seconds() < 15
    waited = client.wait(job.id, timeout=110)
    assert [attempt.reason for attempt in waited.attempts] == ["preempted", "completed"]
    first, second = waited.attempts
    assert first.message == f"It made room for job {urgent.id}. The work up to then is kept."
    assert first.ended_at is not None
    # The worker lives on, and the urgent job has its turn before the one that made room.
    assert first.worker == second.worker == ended.attempts[0].worker
    assert first.ended_at <= ended.started_at <= second.started_at
    # It goes on from the last step that was done.
    assert second.details["resumed_at_step"] == max(steps_of(client, job.id, until=second.started_at))
    assert final_checkpoint(waited) == final_checkpoint(undisturbed)


@pytest.mark.extra
def test_a_drained_worker_changes_nothing_in_the_result(client: Client, undisturbed: JobView) -> None:
    job = client.submit(UNFILMED)
    until_checkpoint(client, job)
    (worker,) = client.workers()
    os.kill(worker.pid, signal.SIGTERM)  # The stack starts another one in its place.
    ended = client.wait(job.id, timeout=110)
    assert [attempt.reason for attempt in ended.attempts] == ["worker_drained", "completed"]
    assert final_checkpoint(ended) == final_checkpoint(undisturbed)


@pytest.mark.extra
def test_a_running_job_has_what_its_page_pushes_and_watch_opens_the_page(
    client: Client, tmp_path: Path
) -> None:
    asked = tmp_path / "asked"
    job = client.submit({**SMALL, "algorithm": {**SMALL["algorithm"], "num_timesteps": 10_000_000}})
    with watching(client, job.id, asked) as watch:
        steps = list[int]()
        for event in client.events(job.id):
            if event.kind == "artifact" and event.data["name"] == "policy.npz":
                steps.append(event.data["step"])
            if event.kind == "artifact" and event.data["role"] == "replay" and len(steps) > 1:
                break
        running = client.get(job.id)
        content = client.download(job.id, "policy.npz", tmp_path)
        client.cancel(job.id)
        said, _ = watch.communicate(timeout=110)
    assert running.status == "running"
    assert {a.role for a in running.artifacts} == DURING
    # The newest alone is kept; a newer one may have come since.
    [policy] = [a for a in running.artifacts if a.name == "policy.npz"]
    assert (
        51_200 == steps[0] < steps[1] <= policy.step <= exported_policy.load(content).about["trained_steps"]
    )
    simulation = running.artifact("simulation.json")
    assert simulation is not None
    assert simulation.metadata == {"can_run": True}
    assert asked.read_text() == f"{client.base_url}/#/jobs/{job.id}/replay\n"
    assert f"Job {job.id} cancelled" in said
    assert watch.returncode == 1


def test_a_cancel_keeps_the_checkpoint_the_policy_and_the_video(client: Client) -> None:
    # Before its first evaluation.
    assert cancelled(client, SMALL) == KEPT - {"best_policy"}


def cancelled(client: Client, small: dict[str, Any]) -> set[str]:
    """Cancels a training after its first checkpoint; the roles of what it keeps."""
    job = client.submit({**small, "algorithm": {**small["algorithm"], "num_timesteps": 10_000_000}})
    _, pid = until_checkpoint(client, job)
    assert client.cancel(job.id).status == "cancelling"
    ended = client.wait(job.id, timeout=110)
    assert (ended.status, ended.reason) == ("cancelled", "user_cancelled")
    checkpoint, policy = ended.newest("checkpoint"), ended.newest("policy")
    assert checkpoint is not None
    assert policy is not None
    assert checkpoint.step == policy.step
    assert not psutil.pid_exists(pid)
    return {artifact.role for artifact in ended.artifacts}
