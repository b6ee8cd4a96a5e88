"""A file of clips in the confined process: what is found, kept and refused."""

import io
import json
import signal
import sys
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.adapters.postgres.store import PostgresJobStore
from core.clips import archive
from core.clips.clip import Clip
from core.clips.record import ARCHIVE, REPLAY, SCENE, ClipFile, clips_id
from core.errors import BadClips, ClipsNotFound
from core.jobs.job import utc_now
from core.jobs.orphans import differences, mark_missing
from core.rendering.replay.replay_file import read_replay
from core.storage import keys
from core.uploads import library
from tests.in_memory import MemoryJobQueue, MemoryObjectStore
from tests.models import add as add_model
from worker.validation.__main__ import _look
from worker.validation.answer import ClipsAnswer, read_answer, read_progress
from worker.validation.clips import validate_clips
from worker.validation.confined import ANSWER

HOPS = b"""<mujoco><worldbody>
  <geom type="plane" size="5 5 1"/>
  <body name="trunk" pos="0 0 0.5"><freejoint/>
    <geom type="box" size="0.1 0.1 0.05" mass="1"/>
    <body name="leg" pos="0 0 -0.05"><joint name="knee" axis="0 1 0" range="-90 90"/>
      <geom name="foot" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="0.2"/>
    </body>
  </body>
</worldbody><actuator><motor joint="knee"/></actuator></mujoco>"""


def hop(name: str = "hop", joint: str = "knee", frames: int = 26) -> Clip:
    """It rises by 10 cm and bends its knee, upright, at 50 frames/s."""
    time = np.arange(frames) / 50.0
    return Clip(
        name=name,
        rate=50.0,
        root_position=np.stack([0.2 * time, 0 * time, 0.49 + 0.1 * np.sin(np.pi * time)], axis=1),
        root_orientation=np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)),
        joints=(joint,),
        joint_positions=0.3 * np.sin(2 * np.pi * time)[:, None],
    )


@pytest.fixture
def stores(job_store: PostgresJobStore) -> dict[str, Any]:
    return {"store": job_store, "objects": MemoryObjectStore(), "queue": MemoryJobQueue()}


def body_of(stores: dict[str, Any]) -> str:
    """The id of the model, which is ready."""
    store = stores["store"]
    record = add_model(
        HOPS, store=store.models, objects=stores["objects"], queue=stores["queue"], now=utc_now()
    )
    store.models.settle(record.model_copy(update={"status": "ready"}))
    return record.id


def sent(content: bytes, stores: dict[str, Any], folder: Path) -> ClipFile:
    """The record of a file that a worker has examined."""
    file = folder / "sent"
    file.write_bytes(content)
    digest = sha256(content).hexdigest()
    body = body_of(stores)
    record = ClipFile(
        id=clips_id(digest, body, None),
        status="validating",
        media_type="application/octet-stream",
        size=len(content),
        created_at=utc_now(),
        sha256=digest,
        body=body,
    )
    store, objects = stores["store"], stores["objects"]
    library.add(file, record, store=store.clips, objects=objects, queue=stores["queue"])
    assert stores["queue"].contains_upload("clips", record.id)
    spool = folder / "spool"
    spool.mkdir()
    validate_clips(record.id, store, objects, spool, folder)
    return library.find(record.id, store.clips)


def test_what_a_file_holds_is_kept_with_its_archive_and_a_replay(
    tmp_path: Path, stores: dict[str, Any]
) -> None:
    found = sent(archive.to_bytes([hop(), hop("stay", frames=11)]), stores, tmp_path)
    assert (found.status, found.message) == ("ready", None)
    described = found.description
    assert described is not None
    assert [(clip.name, clip.num_frames, clip.rate) for clip in described.clips] == [
        ("hop", 26, 50.0),
        ("stay", 11, 50.0),
    ]
    assert described.clips[0].seconds == pytest.approx(0.5)  # 25 intervals of 1/50 s
    assert (described.joints, described.num_replayed) == (["knee"], 2)
    assert set(described.made) == {ARCHIVE, REPLAY, SCENE}
    objects = stores["objects"]
    kept = tmp_path / "kept.npz"
    kept.write_bytes(objects.get(keys.made_of_clips(found.id, ARCHIVE)))
    [first, _] = archive.from_file(kept)
    np.testing.assert_allclose(first.joint_positions, hop().joint_positions, atol=1e-6)
    assert first.joint_velocities is not None
    header, _ = read_replay(objects.get(keys.made_of_clips(found.id, REPLAY)))
    assert [episode["name"] for episode in header["episodes"]] == ["hop", "stay"]


def hop_seen(frames: int = 26) -> tuple[bytes, dict[str, Any]]:
    """Key points of the hop in mm, an NPZ, and which of its body they are: three of the trunk, which stays
    upright, and the end of the leg."""
    clip = hop(frames=frames)
    trunk, angle = clip.root_position, clip.joint_positions[:, 0]
    offsets = {"a": [0.1, 0.1, 0.0], "b": [0.1, -0.1, 0.0], "c": [-0.1, 0.0, 0.05]}
    toe = trunk + np.stack([-0.4 * np.sin(angle), 0 * angle, -0.05 - 0.4 * np.cos(angle)], axis=1)
    points = np.stack([*(trunk + offset for offset in offsets.values()), toe], axis=1)
    recording = io.BytesIO()
    np.savez(recording, key_points=1000 * points, names=np.array([*offsets, "toe"]), fps=50.0)
    said = {name: {"body": "trunk", "offset": offset} for name, offset in offsets.items()}
    said["toe"] = {"body": "leg", "offset": [0.0, 0.0, -0.4]}
    return recording.getvalue(), {"points": said, "fit_offsets": 0}


def zipped(recording: bytes, points: dict[str, Any]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        file.writestr("points.json", json.dumps(points))
        file.writestr("recording.npz", recording)
    return packed.getvalue()


def test_key_points_become_a_clip_of_their_body(tmp_path: Path, stores: dict[str, Any]) -> None:
    found = sent(zipped(*hop_seen()), stores, tmp_path)
    assert (found.status, found.message) == ("ready", None)
    described = found.description
    assert described is not None
    assert (described.format, described.joints, described.num_replayed) == ("key points", ["knee"], 1)
    assert [(one.name, one.num_seen) for one in described.key_points] == [
        (n, 26) for n in ["a", "b", "c", "toe"]
    ]
    assert max(one.worst_distance or 1 for one in described.key_points) < 0.002
    assert any("read as millimetres" in warning for warning in described.clips[0].warnings)
    (kept := tmp_path / "kept.npz").write_bytes(stores["objects"].get(keys.made_of_clips(found.id, ARCHIVE)))
    [solved] = archive.from_file(kept)
    np.testing.assert_allclose(solved.joint_positions, hop().joint_positions, atol=5e-3)


def test_a_long_recording_says_how_far_its_reading_is(
    tmp_path: Path, stores: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.validation.confined._ASKS_EVERY_S", 0.01)
    told, done = set[str | None](), threading.Event()

    def watch() -> None:
        while not done.is_set():
            told.update(record.message for record in stores["store"].clips.all())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        found = sent(zipped(*hop_seen(frames=1001)), stores, tmp_path)
    finally:
        done.set()
        watcher.join()
    assert (found.status, found.message) == ("ready", None)
    frames = {f"Fitting frame {frame:,} of 1,001." for frame in range(0, 1001, 100)}
    assert told & frames
    assert told <= frames | {None}


def test_a_process_that_says_anything_else_of_its_progress_is_not_believed(tmp_path: Path) -> None:
    assert read_progress(tmp_path) is None
    for said in ("", "half", "1 2 3", "1" * 200, "<b> 2"):
        (tmp_path / "progress").write_text(said)
        assert read_progress(tmp_path) is None


def test_clips_that_are_deleted_while_they_are_read_end_their_process(
    tmp_path: Path, stores: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Deleting(MemoryObjectStore):
        """Somebody deletes the clips as soon as a worker has fetched them."""

        @contextmanager
        def open(self, key: str, **how: Any) -> Iterator[Any]:
            with super().open(key, **how) as pieces:
                content = list(pieces)
            for record in stores["store"].clips.all():
                library.forget(record.id, store=stores["store"].clips, objects=self)
            yield content

    monkeypatch.setattr("worker.validation.confined._ASKS_EVERY_S", 0.01)
    stores["objects"] = Deleting()
    with pytest.raises(ClipsNotFound):
        sent(archive.to_bytes([hop()]), stores, tmp_path)
    assert not (tmp_path / "spool" / "answer.json").exists()
    assert list(stores["objects"].list(keys.clip_files())) == []


class Watched(MemoryObjectStore):
    """Notes in what state the clips are when their files are removed."""

    def __init__(self, store: PostgresJobStore) -> None:
        super().__init__()
        self.store, self.states = store, list[str]()

    def delete_prefix(self, prefix: str) -> None:
        self.states += [record.status for record in self.store.clips.all()]
        super().delete_prefix(prefix)


def test_clips_of_another_body_are_refused_and_their_files_removed_before_they_can_be_sent_again(
    tmp_path: Path, stores: dict[str, Any]
) -> None:
    objects = stores["objects"] = Watched(stores["store"])
    found = sent(archive.to_bytes([hop(joint="elbow")]), stores, tmp_path)
    assert found.status == "refused"
    assert "elbow" in (found.message or "")
    assert list(objects.list(keys.clip_files())) == []
    assert objects.states == ["validating"]


def test_clips_whose_replay_was_lost_are_validated_again(tmp_path: Path, stores: dict[str, Any]) -> None:
    found = sent(archive.to_bytes([hop()]), stores, tmp_path)
    store, objects = stores["store"], stores["objects"]
    replay = keys.made_of_clips(found.id, REPLAY)
    objects.delete_prefix(replay)
    [lost] = [one for one in differences(store=store, objects=objects) if one.owner == found.id]
    assert lost.missing == [replay]
    mark_missing(lost.owner, lost.missing, store=store, objects=objects)
    assert library.find(found.id, store.clips) == found.model_copy(update={"status": "validating"})
    spool = tmp_path / "again"
    spool.mkdir()
    validate_clips(found.id, store, objects, spool, tmp_path)
    assert library.find(found.id, store.clips) == found
    assert objects.info(replay).size > 0
    source = keys.clip_file_source(found.id)
    objects.delete_prefix(source)
    mark_missing(found.id, [source], store=store, objects=objects)
    with pytest.raises(ClipsNotFound):
        library.find(found.id, store.clips)


@pytest.mark.parametrize(
    ("status", "sentence"),
    [
        (None, "The reader was not done with the file of clips within 900 s; make it smaller."),
        (-signal.SIGSEGV, "The reader crashed on the file of clips (SIGSEGV)."),
        (1, "The file of clips could not be read: its content is not as its format asks."),
    ],
)
def test_a_process_that_says_nothing_is_told_by_its_end(
    tmp_path: Path,
    stores: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    status: int | None,
    sentence: str,
) -> None:
    monkeypatch.setattr("worker.validation.clips.run_to_its_end", lambda *_args, **_how: status)
    assert sent(b"clips", stores, tmp_path).message == sentence


def test_a_refusal_that_quotes_the_file_is_text_that_can_be_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refusing(_: Path) -> None:
        raise BadClips("There is no joint `a\0\ud800`.")

    monkeypatch.setattr("worker.validation.clip_findings.clip_findings", refusing)
    _look("clips", tmp_path, ())
    assert read_answer(tmp_path / ANSWER, ClipsAnswer).refusal == "There is no joint `a\\0\\ud800`."


@pytest.mark.extra
def test_what_is_no_file_of_clips_is_refused_in_a_sentence(tmp_path: Path, stores: dict[str, Any]) -> None:
    found = sent(json.dumps({"clips": []}).encode(), stores, tmp_path)
    assert (found.status, found.description) == ("refused", None)
    assert (found.message or "").endswith(".")


def test_those_that_were_deleted_meanwhile_do_not_come_back(tmp_path: Path, stores: dict[str, Any]) -> None:
    with pytest.raises(ClipsNotFound):
        validate_clips(f"sha256:{'0' * 64}", stores["store"], stores["objects"], tmp_path, tmp_path)


@pytest.mark.parametrize(("what", "reader"), [("clips", "clip_findings"), ("model", "findings")])
def test_a_worker_that_cannot_load_its_own_programs_does_not_blame_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, reader: str
) -> None:
    monkeypatch.setitem(sys.modules, f"worker.validation.{reader}", None)
    _look(what, tmp_path, ())
    refusal = read_answer(tmp_path / ANSWER, ClipsAnswer).refusal
    assert refusal is not None
    assert refusal.startswith("This worker cannot load the programs that read such files (import of worker.")
    assert "no fault of the file" in refusal
