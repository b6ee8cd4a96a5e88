"""Quotas by HTTP: who sees and sets them, what is refused, and by which sentence."""

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi import FastAPI

from core.jobs.job import Artifact, utc_now
from core.sweeps.controller import SweepController
from tests.api.accounts import Lab, opened
from tests.api.conftest import Stack
from tests.api.exports import bring, trained
from tests.api.problems import problem
from tests.api.test_models import XML
from tests.contract.recording import LEASE, queued_job

OF_DEFAULT = "/quotas/project/default"
ANT = {"kind": "train", "environment": "ant"}
SWEEP = {
    "job": ANT,
    "method": "grid",
    "parameters": {"seed": [1, 2, 3]},
    "objective": {"metric": "eval/episode_reward", "direction": "maximize"},
}


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def limit(stack: Stack, **quota: float | str) -> Any:
    answer = stack.http.put(OF_DEFAULT, json=quota)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_quota_is_set_whole_shown_with_what_is_used_and_removed(stack: Stack) -> None:
    stack.http.post("/jobs", json=ANT)
    limit(stack, running=2, bytes=10**9)
    made = limit(stack, queued=3, weight=2.5)
    assert made == {
        **{"kind": "project", "name": "default", "weight": 2.5, "queued": 3},
        **{"running": None, "gpu_hours": None, "bytes": None, "highest_priority": "high"},
        "used": {"running": 0, "queued": 1, "gpu_hours": 0.0, "bytes": 0},
    }
    assert stack.http.get("/quotas").json()["items"] == [made]
    assert stack.http.delete(OF_DEFAULT).status_code == 204
    assert stack.http.get("/quotas").json()["items"] == []
    problem(stack.http.delete(OF_DEFAULT), 404, "quota-not-found")


@pytest.mark.parametrize(
    ("body", "pointer", "words"),
    [
        ('{"weight": -1}', "/weight", "`weight`: must be greater than or equal to 0"),
        ('{"weight": NaN}', "/weight", "finite"),
        ('{"weight": Infinity}', "/weight", "finite"),
        ('{"queued": -1}', "/queued", "`queued`: must be greater than or equal to 0"),
        ('{"running": 1.5}', "/running", "integer"),
        ('{"gpu_hours": -0.1}', "/gpu_hours", "`gpu_hours`: must be greater than or equal to 0"),
        ('{"bytes": "40GB"}', "/bytes", "integer"),
        ('{"highest_priority": "urgent"}', "/highest_priority", "'high', 'normal' or 'low'"),
        ('{"gpu-hours": 1}', "/gpu-hours", "gpu_hours"),
    ],
)
def test_what_is_wrong_is_named(stack: Stack, body: str, pointer: str, words: str) -> None:
    answer = stack.http.put(OF_DEFAULT, content=body, headers={"Content-Type": "application/json"})
    document = problem(answer, 422, "invalid-request")
    assert document["errors"][0]["pointer"] == pointer
    assert words in document["errors"][0]["detail"]
    assert stack.http.get("/quotas").json()["items"] == []


def test_quotas_are_of_those_who_exist(stack: Stack) -> None:
    for name in ("legs", "A%20b", "%00"):
        problem(stack.http.put(f"/quotas/project/{name}", json={}), 404, "project-not-found")
        problem(stack.http.delete(f"/quotas/project/{name}"), 404, "quota-not-found")
    document = problem(stack.http.put("/quotas/user/ann", json={}), 409, "accounts-off")
    assert document["detail"] == (
        "This service has no accounts, and so no users; a quota of the project `default` is for all."
    )
    problem(stack.http.put("/quotas/team/ann", json={}), 422, "invalid-request")


def test_admins_set_quotas_and_the_others_see_those_that_concern_them(lab: Lab) -> None:
    root = lab.of("root")
    for whose in ("project/a", "project/b", "user/ann", "user/bob"):
        assert root.put(f"/quotas/{whose}", json={"queued": 1}).status_code == 200
    problem(root.put("/quotas/user/nobody", json={}), 404, "user-not-found")
    problem(root.put("/quotas/user/%00", json={}), 404, "user-not-found")
    problem(lab.of("ann").put("/quotas/user/ann", json={}), 403, "forbidden")
    seen = {
        who: [f"{one['kind']} {one['name']}" for one in lab.of(who).get("/quotas").json()["items"]]
        for who in ("ann", "amy", "two", "root")
    }
    assert seen["ann"] == ["project a", "user ann"]
    assert seen["amy"] == ["project a"]
    assert seen["two"] == ["project a", "project b"]
    assert seen["root"] == ["project a", "project b", "user ann", "user bob"]
    entries = root.get("/audit", params={"action": "quota."}).json()["items"]
    assert [(one["user"], one["object"]) for one in entries][-1] == ("root", "project a")


def test_a_users_quota_is_for_all_of_their_projects_and_a_projects_for_all_of_its_users(lab: Lab) -> None:
    lab.of("root").put("/quotas/user/two", json={"queued": 1})
    lab.of("root").put("/quotas/project/a", json={"queued": 2})
    assert lab.of("two").post("/jobs", json={**ANT, "project": "b"}).status_code == 202
    refused = problem(lab.of("two").post("/jobs", json={**ANT, "project": "a"}), 409, "quota-exceeded")
    assert refused["detail"].startswith("The user two has 1 job in the queue, and its quota is 1")
    answers = [lab.of(who).post("/jobs", json=ANT).status_code for who in ("ann", "amy", "ann")]
    assert answers == [202, 202, 409]


@pytest.mark.parametrize(
    ("quota", "words"),
    [
        ({"queued": 0}, "The project default may queue nothing: its quota of queued jobs is 0."),
        ({"gpu_hours": 0}, "The project default may use no GPU: its quota of GPU-hours is 0."),
        ({"bytes": 0}, "The project default may store nothing: its quota of bytes is 0."),
    ],
)
def test_a_quota_of_zero_refuses_jobs_their_check_and_sweeps(
    stack: Stack, quota: dict[str, float], words: str
) -> None:
    limit(stack, **quota)
    for path, body in (("/jobs", ANT), ("/jobs/check", ANT), ("/sweeps", SWEEP)):
        document = problem(stack.http.post(path, json=body), 409, "quota-exceeded")
        assert document["detail"].startswith(words)
        assert (document["quota"], document["limit"]) == (*quota, 0)
    assert stack.is_empty()


def test_a_priority_above_that_of_the_quota_is_refused_in_jobs_their_check_and_sweeps(stack: Stack) -> None:
    limit(stack, highest_priority="normal")
    high = {**ANT, "priority": "high"}
    of_high = {**SWEEP, "job": high}
    by_priority = {**SWEEP, "parameters": {"priority": ["low", "high"]}}
    sent = (("/jobs", high), ("/jobs/check", high), ("/sweeps", of_high), ("/sweeps", by_priority))
    for path, body in sent:
        document = problem(stack.http.post(path, json=body), 409, "quota-exceeded")
        assert document["detail"] == (
            "The project default may submit jobs of the priority normal at most, and this one has high: "
            "set it to normal."
        )
        assert (document["quota"], document["limit"], document["used"]) == (
            "highest_priority",
            "normal",
            "high",
        )
    assert stack.is_empty()
    for priority in ("normal", "low"):
        assert stack.http.post("/jobs", json={**ANT, "priority": priority}).status_code == 202
    varied = {**of_high, "parameters": {"priority": ["low", "normal"]}}
    assert stack.http.post("/sweeps", json=varied).status_code == 202


def test_the_lower_of_a_users_and_their_projects_highest_priority_holds(lab: Lab) -> None:
    lab.of("root").put("/quotas/user/ann", json={"highest_priority": "low"})
    lab.of("root").put("/quotas/project/a", json={"highest_priority": "normal"})
    answers = {
        (who, priority): lab.of(who).post("/jobs", json={**ANT, "priority": priority}).status_code
        for who in ("ann", "amy")
        for priority in ("low", "normal", "high")
    }
    assert {asked for asked, status in answers.items() if status == 202} == {
        ("ann", "low"),
        ("amy", "low"),
        ("amy", "normal"),
    }


def test_jobs_that_ask_for_a_cpu_need_no_gpu_hours(stack: Stack) -> None:
    limit(stack, gpu_hours=0)
    on_cpu = {**ANT, "resources": {"accelerator": "cpu"}}
    assert stack.http.post("/jobs", json=on_cpu).status_code == 202


def test_a_job_may_wait_though_none_may_run_and_says_why(stack: Stack) -> None:
    limit(stack, running=0)
    assert stack.http.post("/jobs", json=ANT).status_code == 202


def test_a_submission_with_a_known_key_is_answered_though_there_is_no_room_any_more(stack: Stack) -> None:
    key = {"Idempotency-Key": "k"}
    first = {
        path: stack.http.post(path, json=body, headers=key).json()
        for path, body in (("/jobs", ANT), ("/sweeps", SWEEP))
    }
    limit(stack, queued=0, bytes=0)
    for path, body in (("/jobs", ANT), ("/sweeps", SWEEP)):
        again = stack.http.post(path, json=body, headers=key)
        assert (again.status_code, again.json()["id"]) == (202, first[path]["id"])
    changed = {**SWEEP, "parameters": {"seed": [1]}}
    problem(stack.http.post("/sweeps", json=changed, headers=key), 409, "idempotency-key-reused")


def test_bytes_are_refused_where_they_come_in(stack: Stack) -> None:
    """A job has stored 41 KB, which stay, and nothing that stores more is accepted; what runs goes on."""
    limit(stack, bytes=40_000)
    job = stack.store.add(queued_job())
    stack.store.save(claimed := job.claimed("worker-1", utc_now()), lease=LEASE)
    file = Artifact(
        name="a", role="picture", media_type="image/png", size=41_000, sha256="0" * 64, key=f"jobs/{job.id}/a"
    )
    stack.store.save(claimed.with_artifacts((file,)))
    words = "The project default stores 41.0 KB of its 40.0 KB: delete jobs, models or clips first"
    xml = {"content": XML, "headers": {"Content-Type": "application/xml"}}
    archive = {"content": b"PK", "headers": {"Content-Type": "application/zip"}}
    sent: dict[str, Any] = {"/jobs": {"json": ANT}, "/models": xml, "/jobs/import": archive}
    for path, said in sent.items():
        document = problem(stack.http.post(path, **said), 409, "quota-exceeded")
        assert words in document["detail"]
    assert stack.store.get(job.id).status == "starting"
    assert not list(stack.objects.list(""))


def test_an_import_or_a_model_that_does_not_fit_any_more_is_refused_with_its_size(stack: Stack) -> None:
    limit(stack, bytes=3)
    model = stack.http.post("/models", content=XML, headers={"Content-Type": "application/xml"})
    document = problem(model, 409, "quota-exceeded")
    assert f"stores 0 B of its 3 B, and this is {len(XML)} B more" in document["detail"]
    attempt = trained(stack)
    attempt.end()
    archive = stack.http.get(f"/jobs/{attempt.id}/export").content
    (used,) = stack.http.get("/usage").json()["projects"]
    limit(stack, bytes=used["bytes"] + 1)
    document = problem(bring(stack.http, archive), 409, "quota-exceeded")
    assert ", and this is " in document["detail"]
    limit(stack, bytes=2 * used["bytes"])
    assert bring(stack.http, archive).status_code == 201


def test_the_trials_of_a_sweep_wait_until_there_is_room_and_it_says_why(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("core.sweeps.controller._LOOK_FOR_ROOM_S", 0.0)
    limit(stack, queued=2)
    sweep = stack.http.post("/sweeps", json=SWEEP).json()["id"]
    look = SweepController(stack.store, stack.queue, stack.objects).run_once

    def trials() -> list[Any]:
        return stack.http.get(f"/sweeps/{sweep}").json()["trials"]

    look()
    assert [trial["status"] for trial in trials()] == ["queued", "queued"]
    assert look() == look() == 0
    assert stack.http.get(f"/sweeps/{sweep}").json()["message"] == (
        "Its next trial waits for room. The project default has 2 jobs in the queue, and its quota is 2: one "
        "has to start, or to be cancelled, first."
    )
    limit(stack)
    assert look() == 2
    assert len(trials()) == 3
    assert stack.http.get(f"/sweeps/{sweep}").json()["message"] is None


def test_a_trial_waits_for_gpu_hours_and_bytes_too(stack: Stack) -> None:
    sweep = stack.http.post("/sweeps", json=SWEEP).json()["id"]
    look = SweepController(stack.store, stack.queue, stack.objects).run_once
    for quota in ({"gpu_hours": 0}, {"bytes": 0}):
        limit(stack, **quota)
        look()
        found = stack.http.get(f"/sweeps/{sweep}").json()
        assert (found["status"], found["trials"]) == ("running", [])
        assert "its quota of" in found["message"]
    stack.http.post(f"/sweeps/{sweep}/cancel")
    look()
    assert stack.http.get(f"/sweeps/{sweep}").json()["status"] == "cancelled"
