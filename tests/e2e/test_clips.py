"""Clips with real parts: from a file to a training that follows them, on a small body of a user's own."""

from pathlib import Path

import pytest

from core.clips import archive
from gaitway.client import Client
from gaitway.errors import Conflict, Rejected
from tests.unit.worker.validation.test_clips import HOPS, hop, hop_seen

pytestmark = [pytest.mark.extra, pytest.mark.timeout(300)]  # It compiles an update.

ALGORITHM = {
    "num_timesteps": 1280,
    "num_envs": 64,
    "unroll_length": 10,
    "batch_size": 16,
    "num_minibatches": 4,
    "num_evals": 2,
    "num_eval_envs": 4,
    "episode_length": 50,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
}


def test_a_body_trains_to_follow_clips_that_were_sent(client: Client, tmp_path: Path) -> None:
    (model_file := tmp_path / "hops.xml").write_bytes(HOPS)
    model = client.add_model(model_file)
    (file := tmp_path / "hops.npz").write_bytes(archive.to_bytes([hop(), hop("stay", frames=30)]))
    clips = client.add_clips(file, model.id)
    assert clips.description is not None
    assert [clip.name for clip in clips.description.clips] == ["hop", "stay"]
    reference = {"clips": [{"file": clips.id, "names": ["hop"]}]}
    options = {"model": model.id, "reference": reference, "reward": [{"kind": "track_joints"}]}
    environment = {"id": "mjcf", "options": options}
    job = client.submit(environment=environment, algorithm=ALGORITHM, video=None)
    with pytest.raises(Conflict, match="unfinished jobs need the clips"):
        client.delete_clips(clips.id)
    job = client.wait(job.id, timeout=280)
    assert job.succeeded, job.message
    # Two clips have more parts to count failures in than one.
    again = client.submit(
        environment={"id": "mjcf", "options": {**options, "reference": {"clips": [{"file": clips.id}]}}},
        algorithm={**ALGORITHM, "num_timesteps": 2560},
        resume_from={"job": job.id},
        video=None,
    )
    again = client.wait(again.id, timeout=280)
    assert again.succeeded, again.message
    assert again.attempts[-1].details["resumed_at_step"] == 1280
    notes = [event.data.get("text", "") for event in client.events(again.id) if event.kind == "note"]
    assert any("of a job with other clips" in note for note in notes)
    client.delete_clips(clips.id)
    with pytest.raises(Rejected, match="There are no clips"):
        client.submit(environment=environment, algorithm=ALGORITHM)


def test_key_points_are_sent_with_what_they_are(client: Client, tmp_path: Path) -> None:
    recording, points = hop_seen()
    (model_file := tmp_path / "hops.xml").write_bytes(HOPS)
    (file := tmp_path / "hops.npz").write_bytes(recording)
    model = client.add_model(model_file)
    clips = client.add_clips(file, model.id, points=points)
    assert clips.description is not None
    assert max(one.mean_distance or 1 for one in clips.description.key_points) < 1e-3
    assert client.add_clips(file, model.id, points=points).id == clips.id
    assert client.add_clips(file, model.id, points=points | {"lift": 0.01}).id != clips.id
    with pytest.raises(Rejected, match="does not say which points of the body they are"):
        client.add_clips(file, model.id)
