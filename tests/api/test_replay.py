"""A job's replay: as a file with ranges, and the sentence where there is none."""

from typing import Any

from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import problem

ID = "019aa3c2f0b1-5be0c1d2e3"
ADDRESS = f"/jobs/{ID}/replay"


def keep(attempt: Attempt, name: str, body: bytes, step: int | None = None) -> None:
    attempt.keep(name, body, role="replay", media_type="application/octet-stream", step=step)


def test_the_newest_replay_or_that_of_a_step_comes_whole_or_in_part(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, "replay-100.bin", b"GWREPLAY of step 100", 100)
    keep(attempt, "replay-200.bin", b"GWREPLAY of step 200", 200)
    answer = stack.http.get(ADDRESS)
    assert (answer.status_code, answer.content) == (200, b"GWREPLAY of step 200")
    assert stack.http.get(ADDRESS, params={"step": 100}).content.endswith(b"100")
    part = stack.http.get(ADDRESS, headers={"Range": "bytes=0-7"})
    assert (part.status_code, part.content) == (206, b"GWREPLAY")
    assert stack.http.get(ADDRESS, headers={"If-None-Match": answer.headers["ETag"]}).status_code == 304
    assert stack.http.head(ADDRESS).headers["Content-Length"] == "20"
    assert stack.http.get(f"/jobs/{ID}").json()["links"]["replay"] == ADDRESS


def test_the_scene_is_gltf(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    attempt.keep("scene.glb", b"glTF", role="scene", media_type="model/gltf-binary")
    answer = stack.http.get(f"{ADDRESS}/scene")
    assert (answer.content, answer.headers["Content-Type"]) == (b"glTF", "model/gltf-binary")


def test_a_replay_that_may_come_says_when_to_ask_again(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    answer = stack.http.get(ADDRESS)
    assert "is running and has no replay yet" in problem(answer, 404, "artifact-not-ready")["detail"]
    assert int(answer.headers["Retry-After"]) > 0
    keep(attempt, "replay-100.bin", b"GWREPLAY", 100)
    answer = stack.http.get(ADDRESS, params={"step": 150})
    detail = problem(answer, 404, "artifact-not-ready")["detail"]
    assert "no replay of step 150 yet. It has replay-100.bin" in detail


def ended(stack: Stack, *roles: str, **spec: Any) -> str:
    """The service's answer about the replay of a job that ended with these files."""
    attempt = Attempt(stack, job(ID, **spec))
    for role in roles:
        attempt.keep(f"{role}.npz", b"numbers", role=role, media_type="application/octet-stream")
    attempt.end(JobStatus.SUCCEEDED, Reason.COMPLETED)
    return problem(stack.http.get(ADDRESS), 404, "artifact-not-found")["detail"]


def test_an_older_job_says_how_to_get_one(stack: Stack) -> None:
    detail = ended(stack, "trajectory")
    assert "an older version ran it, or its events say why" in detail
    assert "roll its policy out again" in detail


def test_a_job_that_asks_for_no_video_has_no_replay_either(stack: Stack) -> None:
    assert "its `video` is null, and replays show what videos would" in ended(stack, video=None)


def test_a_simulation_comes_as_json_or_the_sentence_why_there_is_none(stack: Stack) -> None:
    address = f"/jobs/{ID}/simulation"
    attempt = Attempt(stack, job(ID))
    assert "has no simulation yet" in problem(stack.http.get(address), 404, "artifact-not-ready")["detail"]
    attempt.keep("policy", b"numbers", role="policy", media_type="application/octet-stream")
    detail = problem(stack.http.get(address), 404, "artifact-not-found")["detail"]
    assert "an older version trained it" in detail
    attempt.keep("simulation.json", b"{}", role="simulation", media_type="application/json")
    answer = stack.http.get(address)
    assert (answer.content, answer.headers["Content-Type"]) == (b"{}", "application/json")


def test_a_choice_among_actions_is_no_policy_that_the_page_runs(stack: Stack) -> None:
    star = {"environment": "brittle_star", "algorithm": {"kind": "dqn"}}
    Attempt(stack, job(ID, **star))
    detail = problem(stack.http.get(f"/jobs/{ID}/simulation"), 404, "artifact-not-found")["detail"]
    assert "the page cannot run its policy" in detail
