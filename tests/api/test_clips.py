"""Files of clips over HTTP, with the worker's part played by the test; and jobs that name them."""

import hashlib
import io
import json
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import mujoco
import pytest
from typer.testing import CliRunner

from api import uploads as route
from core.clips.record import (
    ARCHIVE,
    REPLAY,
    SCENE,
    ClipFacts,
    ClipsDescription,
    KeyPointFacts,
    MadeFile,
    clips_id,
)
from core.environments.terms.describe import inventory
from core.errors import JobFailed
from core.jobs.store import JobQuery
from core.reasons import Reason
from core.storage import keys
from core.sweeps.controller import SweepController
from core.uploads import library
from gaitway.cli.main import app
from tests.api import test_models
from tests.api.conftest import Attempt, Stack
from tests.api.problems import problem
from tests.unit.clips.bodies import JOINTS, WALKER
from worker.protocol import Task
from worker.supervision.starting_point import write_task

FILE = b"0,0,0.5,0,0,0,1,0\n"
MADE = {ARCHIVE: b"archive", REPLAY: b"replay", SCENE: b"scene"}
DESCRIPTION = ClipsDescription(
    format="csv",
    clips=[
        ClipFacts(name="walk", num_frames=101, rate=50.0, seconds=2.0, warnings=["A foot slides."]),
        ClipFacts(name="turn", num_frames=51, rate=50.0, seconds=1.0),
    ],
    joints=["hip_1"],
    key_points=[
        KeyPointFacts(
            name="knee", body="shin", offset=(0, 0, 0), num_seen=90, mean_distance=0.002, worst_distance=0.01
        )
    ],
    made={
        name: MadeFile(sha256=hashlib.sha256(body).hexdigest(), size=len(body)) for name, body in MADE.items()
    },
    num_replayed=2,
)


def send(http: httpx.Client, content: bytes = FILE, **sent: Any) -> httpx.Response:
    headers = {"Content-Type": "application/octet-stream"}
    return http.post("/clips", content=content, headers=headers, params={"body": "g1", **sent})


@contextmanager
def worker(stack: Stack, **found: Any) -> Iterator[None]:
    """A worker that finds this in every file of clips."""
    idle = threading.Event()

    def work() -> None:
        while not idle.is_set():
            if sent := stack.queue.take_upload():
                assert sent[0] == "clips"
                record = library.find(sent[1], stack.store.clips)
                for name, body in MADE.items():
                    stack.objects.put(keys.made_of_clips(record.id, name), body)
                stack.store.clips.settle(record.model_copy(update=found))
            time.sleep(0.01)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        idle.set()
        thread.join()


@pytest.fixture
def clips(stack: Stack) -> str:
    """A file of clips of the G1 that is ready."""
    with worker(stack, status="ready", description=DESCRIPTION):
        return send(stack.http).json()["id"]


def job(*choices: dict[str, Any], environment: str = "g1") -> dict[str, Any]:
    options = {
        "reference": {"clips": choices},
        "reward": [{"kind": "track_joints"}],
        "observation": [{"kind": "qpos"}],
        "critic": None,
        "command": None,
    }
    return {"kind": "train", "environment": {"id": environment, "options": options}}


def test_clips_are_answered_with_what_is_in_them(stack: Stack) -> None:
    with worker(stack, status="ready", description=DESCRIPTION):
        answer = send(stack.http, name="gaits", rate=50)
        again = send(stack.http, rate=50)
    assert (answer.status_code, again.status_code) == (201, 200)
    document = answer.json()
    sha256 = hashlib.sha256(FILE).hexdigest()
    assert document["id"] == clips_id(sha256, "g1", 50.0)
    assert answer.headers["location"] == f"/clips/{document['id']}" == document["links"]["self"]
    assert (document["name"], document["body"], document["rate"]) == ("gaits", "g1", 50.0)
    assert [clip["name"] for clip in document["description"]["clips"]] == ["walk", "turn"]
    assert document["description"]["clips"][0]["warnings"] == ["A foot slides."]
    assert document["description"]["key_points"][0]["mean_distance"] == 0.002
    assert stack.http.get(f"/clips/{document['id']}").json() == document == again.json()
    assert stack.http.get("/clips", params={"name": "gaits"}).json()["items"] == [document]
    assert stack.http.get(document["links"]["file"]).content == FILE
    assert stack.http.get(document["links"]["replay"], headers={"Range": "bytes=1-3"}).content == b"epl"
    assert stack.http.get(document["links"]["scene"]).headers["content-type"] == "model/gltf-binary"


def replaced(description: Any, **changes: Any) -> Any:
    return description.model_copy(update=changes)


def test_the_same_bytes_of_another_body_or_at_another_rate_are_other_clips(stack: Stack) -> None:
    with worker(stack, status="ready", description=DESCRIPTION):
        ids = {send(stack.http, **sent).json()["id"] for sent in ({}, {"rate": 30}, {"body": "humanoid"})}
    assert len(ids) == 3


def test_refused_clips_are_answered_with_the_reason_and_leave_nothing(stack: Stack) -> None:
    with worker(stack, status="refused", message="Frame 3 of `walk` has no number at the joint hip."):
        document = problem(send(stack.http), 422, "bad-clips")
    assert document["detail"] == "Frame 3 of `walk` has no number at the joint hip."
    assert stack.http.get("/clips").json()["items"] == []
    assert list(stack.objects.list(keys.clip_files())) == []


@pytest.mark.parametrize(
    ("sent", "detail"),
    [
        ({"body": "g2"}, "There is no environment 'g2'"),
        ({"body": "mjcf"}, "give the id of the model"),
        ({"body": f"sha256:{'0' * 64}"}, "There is no model"),
        ({"rate": 0}, "greater than 0"),
        ({"name": "a\nb"}, "name"),
    ],
)
def test_what_cannot_be_read_is_refused_before_a_worker_sees_it(
    stack: Stack, sent: dict[str, Any], detail: str
) -> None:
    document = problem(send(stack.http, **sent), 422, "invalid-request")
    assert detail in document["detail"]
    problem(send(stack.http, b""), 422, "bad-clips")
    answer = stack.http.post(
        "/clips", params={"body": "g1"}, content=FILE, headers={"content-type": "text/csv"}
    )
    problem(answer, 415, "unsupported-media-type")
    assert stack.http.get("/clips").json()["items"] == []


def test_they_get_another_name_and_are_deleted(stack: Stack, clips: str) -> None:
    answer = stack.http.patch(f"/clips/{clips}", json={"name": "trots"})
    assert (answer.status_code, answer.json()["name"]) == (200, "trots")
    assert stack.http.get(f"/clips/{clips}").json()["name"] == "trots"
    problem(stack.http.patch(f"/clips/{clips}", json={"name": ""}), 422, "invalid-request")
    assert stack.http.delete(f"/clips/{clips}").status_code == 204
    problem(stack.http.get(f"/clips/{clips}"), 404, "clips-not-found")
    problem(stack.http.patch(f"/clips/{clips}", json={"name": "x"}), 404, "clips-not-found")
    assert list(stack.objects.list(keys.clip_files())) == []


def test_those_without_a_replay_say_why(stack: Stack) -> None:
    told = {"num_replayed": 0, "no_replay": "Its first clip has more than 20,000 frames.", "made": {}}
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update=told)):
        document = send(stack.http).json()
    assert "replay" not in document["links"]
    answer = stack.http.get(f"/clips/{document['id']}/replay")
    assert "more than 20,000 frames" in problem(answer, 404, "artifact-not-found")["detail"]


def test_a_job_names_clips_of_its_body_and_they_stay_while_it_needs_them(stack: Stack, clips: str) -> None:
    answer = stack.http.post("/jobs", json=job({"file": clips, "names": ["walk"], "to_s": 1.5}))
    assert answer.status_code == 202, answer.text
    document = problem(stack.http.delete(f"/clips/{clips}"), 409, "clips-in-use")
    assert document["jobs"] == [answer.json()["id"]]
    stack.http.post(f"/jobs/{answer.json()['id']}/cancel")
    assert stack.http.delete(f"/clips/{clips}").status_code == 204


def test_clips_stay_while_a_sweep_is_to_make_jobs_of_them(stack: Stack, clips: str) -> None:
    of_others = {"clips": [{"file": clips, "names": ["walk"]}]}
    sweep = {
        "job": job({"file": clips, "names": ["turn"]}),
        "method": "grid",
        "parameters": {"environment.options.reference": [of_others]},
        "objective": {"metric": "eval/episode_clip_followed", "direction": "maximize"},
    }
    answer = stack.http.post("/sweeps", json=sweep)
    assert answer.status_code == 202, answer.text
    document = problem(stack.http.delete(f"/clips/{clips}"), 409, "clips-in-use")
    assert (document["jobs"], document["sweeps"]) == ([], [answer.json()["id"]])
    assert "1 unfinished sweeps need the clips" in document["detail"]
    stack.http.post(f"/sweeps/{answer.json()['id']}/cancel")
    SweepController(stack.store, stack.queue, stack.objects).run_once()
    assert stack.http.delete(f"/clips/{clips}").status_code == 204


@pytest.mark.parametrize(
    ("choice", "place", "detail"),
    [
        ({"names": ["gallop"]}, "names", "No clip of sha256:"),
        ({"names": ["turn"], "from_s": 1.5}, "from_s", "the clip 'turn', which takes 1 s"),
        ({"names": ["turn"], "to_s": 1.5}, "to_s", "to_s is past the end"),
        ({"file": f"sha256:{'f' * 64}"}, "file", "`POST /clips` makes them"),
    ],
)
def test_a_job_whose_clips_lack_what_it_names_is_refused(
    stack: Stack, clips: str, choice: dict[str, Any], place: str, detail: str
) -> None:
    document = problem(stack.http.post("/jobs", json=job({"file": clips, **choice})), 422, "invalid-request")
    [wrong] = document["errors"]
    assert wrong["pointer"] == f"/environment/options/reference/clips/0/{place}"
    assert detail in wrong["detail"]


def test_clips_of_another_body_are_refused_by_a_joint_that_is_missing(stack: Stack, clips: str) -> None:
    document = problem(
        stack.http.post("/jobs", json=job({"file": clips}, environment="go1")), 422, "invalid-request"
    )
    assert "are of the body g1, and go1 has no joints called hip_1" in document["detail"]


def test_a_mirror_of_a_body_that_is_not_symmetric_is_refused(stack: Stack) -> None:
    xml = WALKER.replace('<body name="head" pos="0 0 0.35">', '<body name="head" pos="0 0.05 0.35">')
    parts = inventory(mujoco.MjModel.from_xml_string(xml))
    with test_models.worker(
        stack, status="ready", description=replaced(test_models.DESCRIPTION, inventory=parts)
    ):
        model = test_models.send(stack.http, xml.encode()).json()["id"]
    with worker(stack, status="ready", description=replaced(DESCRIPTION, joints=list(JOINTS))):
        clips = send(stack.http, body=model).json()["id"]
    plain, mirrored = {"file": clips}, {"file": clips, "mirror": True}
    options: dict[str, Any] = {
        "model": model,
        "edits": {"servos": [{"joints": [".*_knee"], "kp": 50}]},
        "reference": {"clips": [plain]},
        "reward": [{"kind": "track_joints"}],
    }
    sent: dict[str, Any] = {"kind": "train", "environment": {"id": "mjcf", "options": options}}
    answer = stack.http.post("/jobs/check", json=sent)
    assert answer.status_code == 200, answer.text
    options["reference"] = {"clips": [plain, mirrored]}
    sweep = {"job": sent, "parameters": {"seed": [1, 2]}}
    for path, body, base in (("/jobs", sent, ""), ("/jobs/check", sent, ""), ("/sweeps", sweep, "/job")):
        document = problem(stack.http.post(path, json=body), 422, "invalid-request")
        [wrong] = document["errors"]
        assert wrong["pointer"] == f"{base}/environment/options/reference/clips/1/mirror"
        assert "no joint is the mirror image of `neck`" in wrong["detail"]


def test_clips_of_more_frames_than_a_job_has_room_for_are_refused(stack: Stack) -> None:
    long = ClipFacts(name="day", num_frames=4_320_001, rate=50.0, seconds=86_400.0)
    with worker(stack, status="ready", description=replaced(DESCRIPTION, clips=[long])):
        clips = send(stack.http).json()["id"]
    assert stack.http.post("/jobs/check", json=job({"file": clips, "to_s": 600})).status_code == 200
    half = {"file": clips, "to_s": 43_200, "speed": 2}
    document = problem(stack.http.post("/jobs/check", json=job(half)), 422, "invalid-request")
    [wrong] = document["errors"]
    assert wrong["pointer"] == "/environment/options/reference/clips"
    # 43,200 s in half the time, and both ends.
    assert (
        "have 1,080,001 frames at the rate of the control steps, and a job has room for " in wrong["detail"]
    )


def test_clips_that_are_not_validated_yet_are_refused(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.01)
    answer = send(stack.http)
    assert (answer.status_code, answer.json()["status"]) == (202, "validating")
    document = problem(
        stack.http.post("/jobs", json=job({"file": answer.json()["id"]})), 422, "invalid-request"
    )
    assert "still being validated" in document["detail"]


def test_clips_that_are_being_read_say_how_far_that_is(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.01)
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    clips = send(stack.http).json()["id"]
    said = "Fitting frame 1,200 of 30,000."
    stack.store.clips.settle(replaced(stack.store.clips.find(clips), message=said))
    document = stack.http.get(f"/clips/{clips}").json()
    assert (document["status"], document["message"]) == ("validating", said)
    assert said in CliRunner().invoke(app, ["clips", "show", clips]).stdout
    assert said in CliRunner().invoke(app, ["clips", "list"]).stdout


def test_they_go_along_in_an_export_and_come_back_where_they_are(stack: Stack, clips: str) -> None:
    found = stack.store.get(stack.http.post("/jobs", json=job({"file": clips})).json()["id"])
    attempt = Attempt(stack, found, is_new=False)
    attempt.end()
    sent = stack.http.get(f"/jobs/{attempt.id}/export").content
    with zipfile.ZipFile(io.BytesIO(sent)) as archive:
        [told] = json.loads(archive.read("clips.json"))["files"]
        assert archive.read(told["path"]) == FILE
        assert (told["body"], told["rate"]) == ("g1", None)
    headers = {"Content-Type": "application/zip"}
    answer = stack.http.post("/jobs/import", content=sent, headers=headers)
    assert answer.status_code == 201, answer.text
    for found in stack.store.list(JobQuery()).jobs:
        assert stack.http.delete(f"/jobs/{found.id}").status_code == 204
    assert stack.http.delete(f"/clips/{clips}").status_code == 204
    document = problem(stack.http.post("/jobs/import", content=sent, headers=headers), 422, "bad-export")
    assert "gaitway clips add" in document["detail"]


def test_the_training_process_gets_them_as_files_by_their_ids(
    stack: Stack, clips: str, tmp_path: Path
) -> None:
    found = stack.http.post("/jobs", json=job({"file": clips})).json()["id"]
    claim = Attempt(stack, stack.store.get(found), is_new=False).claim
    write_task(stack.store.get(found), claim, "cpu", tmp_path)
    task = Task.model_validate_json((tmp_path / "task.json").read_text())
    assert [*task.clips] == [clips]
    assert (tmp_path / task.clips[clips]).read_bytes() == MADE[ARCHIVE]
    stack.objects.delete_prefix(keys.clip_file(clips))
    with pytest.raises(JobFailed, match="Delete them, and send them again") as failed:
        write_task(stack.store.get(found), claim, "cpu", tmp_path)
    assert failed.value.reason == Reason.BAD_CLIPS
    stack.store.clips.delete(clips)
    with pytest.raises(JobFailed, match="were deleted before the job began"):
        write_task(stack.store.get(found), claim, "cpu", tmp_path)


def test_a_training_resumes_with_other_clips_and_its_own_attempts_exactly(
    stack: Stack, clips: str, tmp_path: Path
) -> None:
    first = stack.http.post("/jobs", json=job({"file": clips})).json()["id"]
    with worker(stack, status="ready", description=DESCRIPTION):
        other = send(stack.http, FILE + b"\n").json()["id"]
    attempt = Attempt(stack, stack.store.get(first), is_new=False)
    facts = {"role": "checkpoint", "media_type": "application/msgpack"}
    attempt.keep("checkpoint-1.msgpack", step=1, **facts)
    attempt.end()

    def posted(**changes: Any) -> httpx.Response:
        sent = {**job({"file": other}), "resume_from": {"job": first}}
        sent["environment"]["options"]["reference"] |= changes
        return stack.http.post("/jobs", json=sent)

    document = problem(posted(ahead={"frames": 5}), 422, "invalid-request")
    assert document["errors"][0]["pointer"] == "/environment/options/reference/ahead/frames"
    assert "so may the clips of a reference" in document["detail"]
    answer = posted(sampling={"kind": "uniform"})
    assert answer.status_code == 202, answer.text
    attempt = Attempt(stack, stack.store.get(answer.json()["id"]), is_new=False)

    def has_new_clips() -> bool:
        write_task(stack.store.get(attempt.id), attempt.claim, "cpu", tmp_path)
        task = Task.model_validate_json((tmp_path / "task.json").read_text())
        assert task.checkpoint is not None
        return task.new_clips

    assert has_new_clips()
    attempt.keep("checkpoint-2.msgpack", step=2, **facts)
    assert not has_new_clips()
