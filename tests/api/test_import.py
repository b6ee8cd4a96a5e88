"""An export comes back as an ended job, which is used like any other."""

import hashlib
import io
import json
import os
from datetime import UTC, datetime, timedelta
from typing import Any
from zipfile import ZipFile

import pytest

from core.jobs import feeds
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery
from core.reasons import Reason
from core.storage import keys
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.exports import bring, changed, edit, sent_in_pieces, trained
from tests.api.problems import problem
from tests.api.test_models import DESCRIPTION, XML, send, worker


def feeds_of(stack: Stack, job_id: str) -> tuple[str, str]:
    log, table = f"/jobs/{job_id}/logs", f"/jobs/{job_id}/metrics?format=csv"
    return stack.http.get(log).text, stack.http.get(table).text


def test_a_run_comes_back_with_its_files_metrics_and_log(stack: Stack) -> None:
    attempt = trained(stack, algorithm={"kind": "ppo", "num_timesteps": 200})
    attempt.end()
    before = stack.http.get(f"/jobs/{attempt.id}").json()
    answer = bring(stack.http, stack.http.get(f"/jobs/{attempt.id}/export").content)
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert answer.headers["location"] == f"/jobs/{found['id']}" == found["links"]["self"]
    assert stack.http.get(f"/jobs/{found['id']}").json() == found
    brief = [{**attempt, "details": {}} for attempt in found["attempts"]]
    newest = stack.http.get("/jobs").json()["items"][0]  # Its id is of now.
    assert newest == {**found, "attempts": brief}

    origin = found.pop("imported_from")
    assert before.pop("imported_from") is None
    assert origin["job"] == attempt.id
    assert origin["version"]
    assert abs(datetime.fromisoformat(origin["imported_at"]) - datetime.now(UTC)) < timedelta(minutes=1)
    for view in (before, found):
        del view["links"]
    own = {(file["name"], file["sha256"], file["step"]): file for file in found.pop("artifacts")}
    others = {(file["name"], file["sha256"], file["step"]): file for file in before.pop("artifacts")}
    assert {name for name, _, _ in others} - {name for name, _, _ in own} == {"checkpoint-100.ckpt"}
    for identity, file in own.items():
        body = stack.http.get(file["href"])
        assert body.content == stack.http.get(others[identity]["href"]).content
        assert body.headers["content-type"] == file["media_type"] == others[identity]["media_type"]
        assert file["metadata"] == others[identity]["metadata"]
    assert found.pop("id") != before.pop("id")
    assert found == before
    assert feeds_of(stack, stack.http.get("/jobs").json()["items"][0]["id"]) == feeds_of(stack, attempt.id)


def test_it_is_used_like_any_ended_job(stack: Stack, exported: bytes) -> None:
    found = bring(stack.http, exported).json()["id"]
    while feeds.compact(store=stack.store, objects=stack.objects):
        pass
    resumed = {"kind": "train", "environment": "ant", "resume_from": {"job": found}}
    rolled = {"kind": "rollout", "environment": "ant", "policy": {"kind": "checkpoint", "job": found}}
    for spec in (resumed, rolled):
        answer = stack.http.post("/jobs", json=spec)
        assert answer.status_code == 202, answer.text
        borrower = answer.json()["id"]
        document = problem(stack.http.delete(f"/jobs/{found}"), 409, "job-in-use")
        assert document["jobs"] == [borrower]
        stack.http.post(f"/jobs/{borrower}/cancel")
    for part in ("video", "policy", "specification", "report.html", "export", "checkpoints/200"):
        assert stack.http.get(f"/jobs/{found}/{part}").status_code == 200
    report = stack.http.get(f"/jobs/{found}/report.html").text
    assert "imported: job 019aa3c2f0b1-5be0c1d2e3 of a service with Gaitway" in report
    events = stack.http.get(f"/jobs/{found}/events").text
    assert "Imported: this is job 019aa3c2f0b1-5be0c1d2e3 of a service with Gaitway" in events
    assert events.rstrip().rpartition("event: ")[2].startswith("status")
    again = bring(stack.http, stack.http.get(f"/jobs/{found}/export").content).json()
    assert again["imported_from"]["job"] == found
    assert stack.http.delete(f"/jobs/{found}").status_code == 204
    assert not list(stack.objects.list(keys.job(found)))


def test_the_specification_with_its_defaults_resumes_from_it(stack: Stack, exported: bytes) -> None:
    found = bring(stack.http, exported).json()["id"]
    with ZipFile(io.BytesIO(exported)) as archive:
        spec = json.loads(archive.read("spec.json"))
    assert spec["environment"]["options"] != {}
    answer = stack.http.post("/jobs", json={**spec, "resume_from": {"job": found}})
    assert answer.status_code == 202, answer.text
    had = spec["environment"]["options"]
    paid = {**spec, "environment": {"id": "ant", "options": {**had, "healthy_reward": 17.0}}}
    # What a step is worth has no shape.
    assert stack.http.post("/jobs", json={**paid, "resume_from": {"job": found}}).status_code == 202
    changed = {**had, "healthy_reward": 17.0, "terminate_when_unhealthy": False}
    other = {**spec, "environment": {"id": "ant", "options": changed}, "resume_from": {"job": found}}
    refused = problem(stack.http.post("/jobs", json=other), 422, "invalid-request")
    place = "/environment/options/terminate_when_unhealthy"
    assert [error["pointer"] for error in refused["errors"]] == [place, "/resume_from/job"]
    assert f"differ at {place}: True there and False here" in refused["detail"]


@pytest.mark.parametrize("status", ["queued", "running", "failed"])
def test_a_run_that_did_not_succeed_comes_as_it_was(stack: Stack, status: str) -> None:
    if status == "queued":
        stack.store.add(original := job())
        job_id = original.id
    else:
        attempt = trained(stack)
        job_id = attempt.id
        if status == "failed":
            attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    before = stack.http.get(f"/jobs/{job_id}").json()
    found = bring(stack.http, stack.http.get(f"/jobs/{job_id}/export").content).json()
    same = ("message", "finished_at", "reason")
    if status == "failed":
        assert found["status"] == "failed"
        assert [found[name] for name in same] == [before[name] for name in same]
        return
    message = f"It was {status} when it was exported; this is what it had then."
    # The last that is known of the job: when its attempt began, after the noon of its other times.
    last = before["created_at"] if status == "queued" else before["attempts"][0]["started_at"]
    assert [found[name] for name in same] == [message, last, "exported_unfinished"]
    assert found["status"] == "cancelled"
    if status == "running":
        [ended] = found["attempts"]
        assert (ended["reason"], ended["ended_at"]) == ("exported_unfinished", last)
        assert {file["role"] for file in found["artifacts"]} == {"checkpoint", "policy", "video", "tables"}
    assert not stack.queue.contains(found["id"], 1)
    assert [dispatch.subject for dispatch in stack.store.undispatched()] == (
        [job_id] if status == "queued" else []
    )


def test_a_job_that_resumed_from_another_keeps_its_name(stack: Stack, exported: bytes) -> None:
    """The record stays as it was sent; ids in it are of the other service."""
    nowhere = {"job": "019aa3c2f0b9-0000000000", "step": None}
    archive = changed(exported, edit("job.json", spec__resume_from=nowhere))
    found = bring(stack.http, archive).json()
    assert found["spec"]["resume_from"] == nowhere
    assert stack.http.get(f"/jobs/{found['id']}/export").status_code == 200
    resumed = {"kind": "train", "environment": "ant", "resume_from": {"job": found["id"]}}
    assert stack.http.post("/jobs", json=resumed).status_code == 202


def test_a_job_on_a_model_comes_back_where_the_model_is(stack: Stack) -> None:
    with worker(stack, status="ready", description=DESCRIPTION):
        model = send(stack.http).json()["id"]
    attempt = Attempt(stack, job(environment={"id": "mjcf", "options": {"model": model}}))
    attempt.end()
    archive = stack.http.get(f"/jobs/{attempt.id}/export").content
    assert bring(stack.http, archive).json()["spec"]["environment"]["options"]["model"] == model
    for found in stack.store.list(JobQuery()).jobs:
        assert stack.http.delete(f"/jobs/{found.id}").status_code == 204
    assert stack.http.delete(f"/models/{model}").status_code == 204
    document = problem(bring(stack.http, archive), 422, "bad-export")
    assert f"The job uses the model {model}" in document["detail"]
    assert stack.is_empty()
    # The same bytes under their own hash, so that the model in the archive is that of the job.
    with ZipFile(io.BytesIO(archive)) as opened:
        [path] = [name for name in opened.namelist() if name.startswith("model/")]
        assert opened.read(path) == XML


def test_an_archive_is_never_held_in_memory(
    stack: Stack, exported: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """32 MiB that cannot be compressed go through the API in pieces."""
    body = os.urandom(2**25)
    big = {"sha256": hashlib.sha256(body).hexdigest(), "size": len(body)}
    with ZipFile(io.BytesIO(exported)) as source:
        names = [file["path"] for file in json.loads(source.read("contents.json"))["files"]]
        artifacts = [file["name"] for file in json.loads(source.read("job.json"))["artifacts"]]
    place, number = names.index("files/policy"), artifacts.index("policy")

    def grow(files: dict[str, bytes]) -> None:
        files["files/policy"] = body
        edit("contents.json", **{f"files__{place}__{name}": value for name, value in big.items()})(files)
        edit("job.json", **{f"artifacts__{number}__{name}": value for name, value in big.items()})(files)

    archive = changed(exported, grow)
    seen = dict[str, int]()

    def discard(key: str, stream: Any, size: int, **_: Any) -> None:
        while piece := stream.read(2**20):
            seen[key] = seen.get(key, 0) + len(piece)

    monkeypatch.setattr(stack.objects, "put_stream", discard)

    view = memoryview(archive)
    answer, peak = sent_in_pieces(stack, (view[at : at + 2**20] for at in range(0, len(archive), 2**20)))
    assert answer.status_code == 201, answer.text
    assert max(seen.values()) == len(body)
    assert peak < 2**24


def test_noon_is_the_time_of_what_was_measured(stack: Stack, exported: bytes) -> None:
    found = bring(stack.http, exported).json()["id"]
    rows = stack.http.get(f"/jobs/{found}/metrics").json()["rows"]
    assert [datetime.fromisoformat(row["time"]) for row in rows] == [NOON, NOON]
    assert rows[0]["values"] == {"eval/episode_reward": 100 / 7, "eval/not_finite": None}
