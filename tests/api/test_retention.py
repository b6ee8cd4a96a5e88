"""Retention rules by HTTP: who may set them, what is refused, and what a preview shows."""

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi import FastAPI

from core.jobs import removal
from core.jobs.status import JobStatus
from tests.api.accounts import Lab, opened
from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import problem
from tests.contract.recording import queued_job

RULES = "/projects/default/retention"
PREVIEW = f"{RULES}/preview"


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def ended(stack: Stack, *, status: JobStatus = JobStatus.SUCCEEDED, **spec: Any) -> Attempt:
    """A job with three checkpoints of 10 bytes, a video of 100, and a policy."""
    attempt = Attempt(stack, job(**spec))
    for step in (10, 20, 30):
        attempt.keep(f"checkpoint-{step}", b"c" * 10, role="checkpoint", step=step)
    attempt.keep("video.mp4", b"v" * 100, role="video")
    attempt.keep("policy", b"p", role="policy")
    attempt.end(status)
    return attempt


def test_rules_are_previewed_set_applied_and_ended(stack: Stack) -> None:
    nothing = stack.http.get(RULES).json()
    assert (nothing["project"], nothing["set_at"], nothing["checkpoints"]) == ("default", None, None)
    attempt = ended(stack, name="run")
    seen = stack.http.post(PREVIEW, json={"checkpoints": 1}).json()
    assert (seen["jobs"], seen["whole_jobs"], seen["files"], seen["bytes"]) == (1, 0, 2, 20)
    assert seen["roles"] == [{"role": "checkpoint", "files": 2, "bytes": 20}]
    assert seen["largest"] == [
        {
            "job": attempt.id,
            "name": "run",
            "owner": None,
            "whole": False,
            "rules": ["checkpoints"],
            "files": 2,
            "bytes": 20,
        }
    ]
    assert (seen["needed"], seen["num_needed"], seen["pinned"]) == ([], 0, 0)
    made = stack.http.put(RULES, json={"checkpoints": 1}).json()
    assert (made["checkpoints"], made["videos_days"], made["set_by"]) == (1, None, None)
    assert stack.http.get(RULES).json() == made
    list(removal.apply(store=stack.store, objects=stack.objects))
    view = stack.http.get(f"/jobs/{attempt.id}").json()
    assert [one["name"] for one in view["artifacts"]] == ["checkpoint-30", "video.mp4", "policy"]
    (removed,) = view["removed"]
    assert (removed["rule"], removed["files"], removed["bytes"]) == ("checkpoints", 2, 20)
    assert stack.http.delete(RULES).status_code == 204
    assert stack.http.delete(RULES).status_code == 204
    assert stack.http.get(RULES).json() == nothing


def test_what_asks_for_a_removed_file_hears_which_rule_removed_it(stack: Stack) -> None:
    attempt = ended(stack)
    stack.http.put(RULES, json={"checkpoints": 1})
    list(removal.apply(store=stack.store, objects=stack.objects))
    today = f"{stack.store.now():%Y-%m-%d}"
    words = f"The retention rule `checkpoints` of its project removed older checkpoints on {today}."
    for wanted in (
        stack.http.get(f"/jobs/{attempt.id}/checkpoints/10"),
        stack.http.post("/jobs", json=_resumed(attempt.id, 10)),
    ):
        assert wanted.status_code in (404, 422)
        assert wanted.json()["detail"].endswith(words)


def _resumed(source: str, step: int) -> dict[str, Any]:
    settings = {"kind": "ppo", "num_timesteps": 10**9}
    source_of = {"job": source, "step": step}
    return {"kind": "train", "environment": "ant", "algorithm": settings, "resume_from": source_of}


@pytest.mark.parametrize(
    ("rules", "pointer", "words"),
    [
        ({"checkpoints": 0}, "/checkpoints", "1"),
        ({"checkpoints": -3}, "/checkpoints", "1"),
        ({"videos_days": 0}, "/videos_days", "1"),
        ({"failed_days": -1}, "/failed_days", "1"),
        ({"cancelled_days": 4000}, "/cancelled_days", "3650"),
        ({"replays_days": 1.5}, "/replays_days", "replays_days"),
        ({"checkpoints": "2"}, "/checkpoints", "checkpoints"),
        ({"policies": 1}, "/policies", "policies"),
        ({"succeeded_days": 1}, "/succeeded_days", "succeeded_days"),
        ({}, "", "No rule says anything. Give one of checkpoints, videos_days"),
        ({"checkpoints": None}, "", "No rule says anything"),
    ],
)
def test_rules_that_are_wrong_are_refused_with_their_place(
    stack: Stack, rules: dict[str, Any], pointer: str, words: str
) -> None:
    for answer in (stack.http.put(RULES, json=rules), stack.http.post(PREVIEW, json=rules)):
        found = problem(answer, 422, "invalid-request")
        assert [one["pointer"] for one in found["errors"]] == [pointer]
        assert words in found["detail"]
    assert stack.http.get(RULES).json()["set_at"] is None


def test_rules_that_would_take_what_a_waiting_job_needs_are_refused_with_the_job(stack: Stack) -> None:
    attempt = ended(stack)
    waiting = stack.store.add(queued_job(resume_from={"job": attempt.id, "step": 10}))
    refused = problem(stack.http.put(RULES, json={"checkpoints": 1}), 409, "retention-needed")
    assert f"job {attempt.id} is needed by {waiting.id}" in refused["detail"]
    assert refused["needed"] == {attempt.id: [waiting.id]}
    seen = stack.http.post(PREVIEW, json={"checkpoints": 1}).json()
    assert (seen["files"], seen["num_needed"]) == (1, 1)
    assert seen["needed"] == [
        {"job": attempt.id, "name": None, "needed_by": [waiting.id], "num_needed_by": 1, "sweep": None}
    ]


def test_members_see_rules_and_admins_alone_set_them(lab: Lab) -> None:
    path = "/projects/a/retention"
    assert lab.of("root").put(path, json={"videos_days": 30}).status_code == 200
    seen = lab.of("vic").get(path).json()
    assert (seen["videos_days"], seen["set_by"]) == (30, "root")
    assert lab.of("vic").post(f"{path}/preview", json={"videos_days": 1}).json()["jobs"] == 0
    assert problem(lab.of("ann").put(path, json={"videos_days": 1}), 403, "forbidden")
    assert problem(lab.of("ann").delete(path), 403, "forbidden")
    for method, part in (("GET", ""), ("POST", "/preview")):
        hidden = lab.of("bob").request(method, f"{path}{part}", json={"videos_days": 1})
        assert problem(hidden, 404, "project-not-found")
    nowhere = "/projects/nowhere/retention"
    for answer in (
        lab.of("root").get(nowhere),
        lab.of("root").put(nowhere, json={"videos_days": 1}),
        lab.of("root").post(f"{nowhere}/preview", json={"videos_days": 1}),
        lab.of("root").delete(nowhere),
    ):
        assert problem(answer, 404, "project-not-found")


def test_a_preview_hides_jobs_of_other_projects(lab: Lab) -> None:
    stack = lab.stack
    attempt = Attempt(stack, job().model_copy(update={"project": "a"}))
    for step in (10, 20):
        attempt.keep(f"checkpoint-{step}", role="checkpoint", step=step)
    attempt.end()
    waiting = queued_job(resume_from={"job": attempt.id, "step": 10})
    stack.store.add(waiting.model_copy(update={"project": "b"}))
    path = "/projects/a/retention/preview"
    for user, ids in (("ann", []), ("two", [waiting.id])):
        (needed,) = lab.of(user).post(path, json={"checkpoints": 1}).json()["needed"]
        assert (needed["needed_by"], needed["num_needed_by"]) == (ids, 1)
