"""Whose things are: what is hidden from whom, what one may change, and how accounts are kept."""

from collections.abc import Iterator
from datetime import timedelta
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from api import first_admin
from api.access import names
from api.routes import ROUTERS, sharing
from core.accounts.principal import Ownership, TokenScope
from core.adapters import wiring
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from core.sweeps.controller import SweepController
from core.user_models.record import ModelRecord
from gaitway.schema import FINAL_STATUSES
from tests.api.accounts import NOBODY, Lab, opened
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.exports import changed, edit
from tests.api.problems import pointers, problem
from tests.api.test_models import DESCRIPTION

JOB = {"kind": "train", "environment": "ant", "video": None}
SWEEP = {"job": JOB, "method": "grid", "parameters": {"seed": [1, 2]}}
MODEL = f"sha256:{'1' * 64}"
ON_MODEL = {"id": "mjcf", "options": {"model": MODEL}}


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def submitted(client: httpx.Client, **also: Any) -> dict[str, Any]:
    answer = client.post("/jobs", json={**JOB, **also})
    assert answer.status_code == 202, answer.text
    return answer.json()


def model_of_ann(lab: Lab, content: bytes | None = None) -> None:
    model_id = MODEL if content is None else f"sha256:{sha256(content).hexdigest()}"
    record = ModelRecord(
        id=model_id,
        status="ready",
        media_type="application/xml",
        size=7,
        created_at=NOON,
        description=DESCRIPTION,
    )
    lab.stack.store.models.add(record)
    lab.stack.store.models.claim(model_id, Ownership("ann", "a"))


def trained_by_ann(lab: Lab) -> str:
    """A job that has ended, with a checkpoint."""
    attempt = Attempt(lab.stack, lab.stack.store.get(submitted(lab.of("ann"))["id"]), is_new=False)
    attempt.keep("1000.ckpt", role="checkpoint", step=1000, media_type="application/octet-stream")
    attempt.end()
    return attempt.id


def test_a_job_is_of_its_submitter_and_in_their_project(lab: Lab) -> None:
    job = submitted(lab.of("ann"))
    assert (job["owner"], job["project"]) == ("ann", "a")
    assert submitted(lab.of("two"), project="b")["project"] == "b"
    assert submitted(lab.of("root"))["project"] == "default"
    assert submitted(lab.of("root"), project="a")["project"] == "a"
    sweep = lab.of("bob").post("/sweeps", json=SWEEP).json()
    assert (sweep["owner"], sweep["project"]) == ("bob", "b")
    assert lab.of("two").post("/sweeps", json={**SWEEP, "project": "a"}).json()["project"] == "a"
    assert (
        lab.of("two").post("/sweeps", json={**SWEEP, "job": {**JOB, "project": "b"}}).json()["project"] == "b"
    )


@pytest.mark.parametrize("path", ["/jobs", "/sweeps"])
def test_a_project_that_one_may_not_use_is_refused_with_its_place(lab: Lab, path: str) -> None:
    body = SWEEP if path == "/sweeps" else JOB

    def refused(user: str, project: object) -> str:
        document = problem(lab.of(user).post(path, json={**body, "project": project}), 422, "invalid-request")
        assert pointers(document) == ["/project"]
        return document["detail"]

    assert "Yours are: a." in refused("ann", "b")
    assert refused("ann", "b") == refused("ann", "nowhere").replace("nowhere", "b")
    assert "one of a, b" in refused("two", None)
    assert "There is no project 'nowhere'" in refused("root", "nowhere")
    refused("ann", "not a name")
    assert lab.stack.is_empty()


def test_everything_under_a_job_or_sweep_of_another_project_is_not_found(lab: Lab) -> None:
    job_id = trained_by_ann(lab)
    sweep_id = lab.of("ann").post("/sweeps", json=SWEEP).json()["id"]
    model_of_ann(lab)
    ids = {"{job_id}": job_id, "{sweep_id}": sweep_id, "{model_id}": MODEL, "{name}": "x", "{step}": "1000"}
    hidden = [name for router in ROUTERS for route in router.routes for name in names(route)]
    hidden = [name for name in hidden if any(one in name for one in ("{job_id}", "{sweep_id}", "{model_id}"))]
    assert len(hidden) > 20
    for route in hidden:
        method, _, path = route.partition(" ")
        for name, value in ids.items():
            path = path.replace(name, value)
        missing = path.replace(job_id, "0" * 12 + "-" + "0" * 10).replace(sweep_id, "0" * 12 + "-" + "0" * 10)
        missing = missing.replace(MODEL, f"sha256:{'0' * 64}")
        foreign, none = lab.of("bob").request(method, path), lab.of("bob").request(method, missing)
        assert (foreign.status_code, none.status_code) == (404, 404), route
        assert foreign.json()["type"] == none.json()["type"], route
        assert lab.of("root").request(method, path).status_code != 403, route


def test_a_member_reads_but_only_the_owner_or_an_admin_changes(lab: Lab) -> None:
    job_id = submitted(lab.of("ann"))["id"]
    sweep_id = lab.of("ann").post("/sweeps", json=SWEEP).json()["id"]
    model_of_ann(lab)
    for path in (f"/jobs/{job_id}", f"/sweeps/{sweep_id}", f"/models/{MODEL}"):
        assert lab.of("amy").get(path).json()["owner"] == "ann"
        assert lab.of("vic").get(path).status_code == 200
        assert "belongs to ann" in problem(lab.of("amy").delete(path), 403, "forbidden")["detail"]
        problem(lab.of("root", TokenScope.SUBMIT).delete(path), 404, path.split("/")[1][:-1] + "-not-found")
    problem(lab.of("amy").post(f"/jobs/{job_id}/cancel"), 403, "forbidden")
    assert lab.of("ann").post(f"/jobs/{job_id}/cancel").status_code == 200
    assert lab.of("root").delete(f"/jobs/{job_id}").status_code == 204
    assert lab.of("root").post(f"/sweeps/{sweep_id}/cancel").status_code == 202
    assert lab.of("ann").delete(f"/models/{MODEL}").status_code == 204


def test_a_job_from_before_the_accounts_is_in_the_default_project_and_an_admins(lab: Lab) -> None:
    old = lab.stack.store.add(job())
    problem(lab.of("ann").get(f"/jobs/{old.id}"), 404, "job-not-found")
    lab.stack.store.change_members("default", NOBODY, add=["amy"])
    assert lab.of("amy").get(f"/jobs/{old.id}").json()["owner"] is None
    document = problem(lab.of("amy").post(f"/jobs/{old.id}/cancel"), 403, "forbidden")
    assert "made without accounts" in document["detail"]
    assert lab.of("root").post(f"/jobs/{old.id}/cancel").status_code == 200


def test_listings_have_ones_own_first_and_nothing_of_other_projects(lab: Lab) -> None:
    ids = [
        submitted(lab.of(user), project=project)["id"]
        for user, project in [("ann", "a"), ("amy", "a"), ("bob", "b"), ("two", "a"), ("ann", "a")]
    ]

    def seen(user: str, **params: Any) -> list[int]:
        found = (
            lab.of(user).get("/jobs", params=params, headers={"Cache-Control": "max-age=9"}).json()["items"]
        )
        return [ids.index(job["id"]) for job in found]

    assert seen("ann") == [4, 0, 3, 1]
    assert seen("amy") == [1, 4, 3, 0]
    assert seen("bob") == [2]
    assert seen("two") == [3, 4, 2, 1, 0]
    assert seen("vic") == [4, 3, 1, 0]
    assert seen("root") == [4, 3, 2, 1, 0]
    assert seen("two", owner="ann") == [4, 0]
    assert seen("two", project="b") == [2]
    assert seen("bob", owner="ann") == []
    problem(lab.of("bob").get("/jobs", params={"project": "a"}), 422, "invalid-request")
    for user in ("ann", "bob"):
        lab.of(user).post("/sweeps", json=SWEEP)
    assert [one["owner"] for one in lab.of("ann").get("/sweeps").json()["items"]] == ["ann"]
    model_of_ann(lab)
    assert [one["owner"] for one in lab.of("amy").get("/models").json()["items"]] == ["ann"]
    assert lab.of("bob").get("/models").json()["items"] == []


def test_a_foreign_checkpoint_is_refused_as_one_that_does_not_exist(lab: Lab) -> None:
    job_id, nowhere = trained_by_ann(lab), "0" * 12 + "-" + "0" * 10
    rollout = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": job_id}}
    cases: list[tuple[str, dict[str, Any], str]] = [
        ("/jobs", {**JOB, "resume_from": {"job": job_id}}, "/resume_from/job"),
        ("/jobs", rollout, "/policy/job"),
        ("/jobs", {**rollout, "environment": "ant"}, "/policy/job"),
        ("/sweeps", {**SWEEP, "job": {**JOB, "resume_from": {"job": job_id}}}, "/job/resume_from/job"),
        ("/sweeps", {**SWEEP, "parameters": {"resume_from": [{"job": job_id}]}}, "/parameters/resume_from"),
    ]
    for path, body, pointer in cases:
        document = problem(lab.of("bob").post(path, json=body), 422, "invalid-request")
        assert pointers(document) == [pointer], body
        assert document["detail"] == f"There is no job {job_id!r}."
    assert lab.of("amy").post("/jobs", json=rollout).status_code == 202
    problem(lab.of("bob").get(f"/jobs/{nowhere}"), 404, "job-not-found")


def test_a_deletion_names_no_jobs_of_projects_that_one_does_not_see(lab: Lab) -> None:
    job_id = trained_by_ann(lab)
    rollout = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": job_id}}
    hidden = lab.of("two").post("/jobs", json={**rollout, "project": "b"}).json()["id"]
    document = problem(lab.of("ann").delete(f"/jobs/{job_id}"), 409, "job-in-use")
    assert document["jobs"] == []
    assert f"of job {job_id} (1 in projects that you do not see)" in document["detail"]
    seen = lab.of("amy").post("/jobs", json=rollout).json()["id"]
    assert problem(lab.of("ann").delete(f"/jobs/{job_id}"), 409, "job-in-use")["jobs"] == [seen]
    document = problem(lab.of("root").delete(f"/jobs/{job_id}"), 409, "job-in-use")
    assert sorted(document["jobs"]) == sorted([hidden, seen])


def test_a_job_stays_while_a_sweep_is_to_make_jobs_of_its_checkpoint(lab: Lab) -> None:
    job_id = trained_by_ann(lab)
    rollout = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": job_id}}
    sweep = {"job": rollout, "method": "grid", "parameters": {"seed": [1, 2]}}
    made = lab.of("ann").post("/sweeps", json=sweep)
    assert made.status_code == 202, made.text
    document = problem(lab.of("ann").delete(f"/jobs/{job_id}"), 409, "job-in-use")
    assert (document["jobs"], document["sweeps"]) == ([], [made.json()["id"]])
    assert f"1 unfinished sweeps need a checkpoint of job {job_id}" in document["detail"]
    assert lab.of("ann").post(f"/sweeps/{made.json()['id']}/cancel").is_success
    SweepController(lab.stack.store, lab.stack.queue, lab.stack.objects).run_once()
    assert lab.of("ann").delete(f"/jobs/{job_id}").status_code == 204


def test_a_foreign_model_is_refused_as_one_that_does_not_exist(lab: Lab) -> None:
    model_of_ann(lab)
    bob = lab.of("bob")
    document = problem(bob.post("/jobs", json={**JOB, "environment": ON_MODEL}), 422, "invalid-request")
    assert pointers(document) == ["/environment/options/model"]
    options = {"options": f'{{"model": "{MODEL}"}}'}
    for path in ("/environments/mjcf", "/environments/mjcf/preview"):
        document = problem(bob.get(path, params=options), 422, "invalid-request")
        assert f"There is no model '{MODEL}'" in document["detail"]
        assert lab.of("amy").get(path, params=options).status_code != 422
    sweep = {
        **SWEEP,
        "parameters": {"environment.options.model": [MODEL]},
        "job": {**JOB, "environment": ON_MODEL},
    }
    problem(bob.post("/sweeps", json=sweep), 422, "invalid-request")


def test_a_deleted_model_that_a_job_needs_is_nobodys(lab: Lab) -> None:
    model_of_ann(lab)
    on_model = {**JOB, "environment": ON_MODEL}
    assert lab.of("root").post("/jobs", json=on_model).status_code == 202  # In the project `default`.
    assert lab.of("ann").delete(f"/models/{MODEL}").status_code == 204
    for user in ("ann", "bob"):
        document = problem(lab.of(user).post("/jobs", json=on_model), 422, "invalid-request")
        assert pointers(document) == ["/environment/options/model"]


def test_a_model_of_several_users_keeps_its_name_but_for_an_admin(lab: Lab) -> None:
    model_of_ann(lab, content := b"<mujoco/>")

    def name_after(user: str, name: str, project: str) -> object:
        params, headers = {"name": name, "project": project}, {"Content-Type": "application/xml"}
        return lab.of(user).post("/models", content=content, params=params, headers=headers).json()["name"]

    assert name_after("ann", "dog", "a") == "dog"
    assert name_after("amy", "cat", "a") == "dog"
    assert name_after("bob", "cat", "b") == "dog"
    assert name_after("ann", "cat", "a") == "dog"
    assert name_after("root", "cat", "a") == "cat"


def test_an_export_of_a_foreign_model_is_not_imported(lab: Lab) -> None:
    """Whoever knew a model's hash could have had its bytes, by an export of what they imported."""
    job_id = trained_by_ann(lab)
    archive = lab.of("root").get(f"/jobs/{job_id}/export").content
    zipped = {"Content-Type": "application/zip"}
    answer = lab.of("ann").post("/jobs/import", content=archive, headers=zipped)
    assert answer.status_code == 201, answer.text
    assert (answer.json()["owner"], answer.json()["project"]) == ("ann", "a")
    with pytest.MonkeyPatch.context() as unread:
        unread.setattr(sharing, "receiving", None)
        answer = lab.of("ann").post("/jobs/import?project=b", content=archive, headers=zipped)
        problem(answer, 422, "invalid-request")
    model_of_ann(lab)
    on_model = changed(archive, edit("job.json", spec__environment=ON_MODEL))
    document = problem(
        lab.of("bob").post("/jobs/import", content=on_model, headers=zipped), 422, "bad-export"
    )
    assert "which this service does not have" in document["detail"]


def test_a_worker_is_shown_without_jobs_of_other_projects(lab: Lab) -> None:
    attempt = Attempt(lab.stack, lab.stack.store.get(submitted(lab.of("ann"))["id"]), is_new=False)
    info = WorkerInfo(
        name="worker-1", host="h", pid=1, device="cpu", started_at=NOON, seen_at=NOON, job=attempt.id
    )
    lab.stack.store.announce(info, timedelta(minutes=1))
    [seen] = lab.of("amy").get("/workers").json()["items"]
    [hidden] = lab.of("bob").get("/workers").json()["items"]
    assert (seen["job"], seen["jobs"]) == (attempt.id, [attempt.id])
    assert (hidden["job"], hidden["jobs"]) == (None, [])
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    assert lab.of("ann").get(f"/jobs/{attempt.id}").json()["status"] in FINAL_STATUSES


def test_a_token_makes_none_that_may_more_or_lives_longer(lab: Lab) -> None:
    made = lab.of("ann").post("/tokens", json={"scope": "submit", "name": "laptop"})
    assert made.status_code == 201
    document = made.json()
    assert (document["user"], document["name"], document["revoked_at"]) == ("ann", "laptop", None)
    with lab.with_token(document["secret"]) as client:
        assert client.get("/whoami").json()["scope"] == "submit"
        problem(client.post("/tokens", json={"scope": "admin"}), 403, "forbidden")
        problem(client.post("/tokens", json={"scope": "worker"}), 403, "forbidden")
        problem(client.post("/tokens", json={"scope": "read", "user": "bob"}), 403, "forbidden")
        later = client.post("/tokens", json={"scope": "read", "expires_in_days": None}).json()
        assert later["expires_at"] == document["expires_at"]
    problem(lab.of("vic").post("/tokens", json={"scope": "submit"}), 403, "forbidden")
    worker = lab.of("root").post("/tokens", json={"scope": "worker", "expires_in_days": None}).json()
    assert worker["expires_at"] is None
    assert lab.of("root").post("/tokens", json={"scope": "read", "user": "nobody"}).status_code == 404
    document = problem(lab.of("ann").post("/tokens", json={"scope": "all"}), 422, "invalid-request")
    assert pointers(document) == ["/scope"]


def test_one_lists_and_revokes_ones_own_tokens_and_an_admin_all(lab: Lab) -> None:
    mine = lab.of("ann").post("/tokens", json={"scope": "read"}).json()["id"]
    assert {one["user"] for one in lab.of("ann").get("/tokens").json()["items"]} == {"ann"}
    assert "secret" not in lab.of("ann").get("/tokens").text
    problem(lab.of("bob").delete(f"/tokens/{mine}"), 404, "token-not-found")
    assert lab.of("ann").delete(f"/tokens/{mine}").status_code == 204
    revoked = {one["id"]: one["revoked_at"] for one in lab.of("root").get("/tokens").json()["items"]}
    assert revoked[mine] is not None
    assert {one["user"] for one in lab.of("root").get("/tokens?user=bob").json()["items"]} == {"bob"}


def test_a_token_revokes_none_that_may_do_more(lab: Lab) -> None:
    submits, reads = (lab.token("ann", scope) for scope in (TokenScope.SUBMIT, TokenScope.READ))
    worker = lab.token("root", TokenScope.WORKER)
    document = problem(lab.of("ann", TokenScope.READ).delete(f"/tokens/{submits.id}"), 403, "forbidden")
    assert document["needed_scope"] == "submit"
    problem(lab.of("root", TokenScope.SUBMIT).delete(f"/tokens/{worker.id}"), 403, "forbidden")
    assert lab.of("ann", TokenScope.READ).delete(f"/tokens/{reads.id}").status_code == 204
    assert lab.of("ann", TokenScope.SUBMIT).delete(f"/tokens/{submits.id}").status_code == 204


def test_an_admin_keeps_users_and_projects(lab: Lab) -> None:
    root = lab.of("root")
    assert root.post("/projects", json={"name": "c"}).status_code == 201
    made = root.post("/users", json={"name": "cat", "role": "viewer", "projects": ["c"]})
    assert (made.status_code, made.json()["projects"]) == (201, ["c"])
    problem(root.post("/users", json={"name": "cat"}), 409, "user-exists")
    document = problem(root.post("/users", json={"name": "dog", "projects": ["x"]}), 422, "invalid-request")
    assert pointers(document) == ["/projects"]
    document = problem(root.post("/users", json={"name": "Dog Two"}), 422, "invalid-request")
    assert pointers(document) == ["/name"]
    assert root.patch("/users/cat", json={"role": "submitter"}).json()["role"] == "submitter"
    assert root.patch("/projects/c", json={"add": ["ann"], "remove": ["cat"]}).json()["members"] == ["ann"]
    document = problem(root.patch("/projects/c", json={"add": ["zoe"]}), 422, "invalid-request")
    assert pointers(document) == ["/add"]
    problem(root.patch("/users/root", json={"active": False}), 409, "last-admin")
    assert [one["name"] for one in lab.of("ann").get("/projects").json()["items"]] == ["a", "c"]
    assert {"ann", "cat", "root"} <= {one["name"] for one in root.get("/users").json()["items"]}


@pytest.mark.parametrize("wrong", ["%00", "x" * 300, "..%2Fjobs"])
def test_a_name_that_nothing_can_have_is_not_found(lab: Lab, wrong: str) -> None:
    for user in ("root", "ann"):
        client = lab.of(user)
        assert client.delete(f"/tokens/{wrong}").status_code == 404
        for path in ("jobs", "sweeps", "models"):
            assert client.get(f"/{path}/{wrong}").status_code == 404
            assert client.delete(f"/{path}/{wrong}").status_code == 404
    assert lab.of("root").patch(f"/users/{wrong}", json={"active": True}).status_code == 404
    assert lab.of("root").patch(f"/projects/{wrong}", json={}).status_code == 404
    environment = {"id": "mjcf", "options": {"model": "\0"}}
    problem(lab.of("ann").post("/jobs", json={**JOB, "environment": environment}), 422, "invalid-request")


def test_the_audit_log_says_who_did_what(lab: Lab) -> None:
    named = {"X-Request-ID": "from-the-test", "X-Forwarded-For": "10.9.8.7"}
    job_id = lab.of("ann").post("/jobs", json=JOB, headers=named).json()["id"]
    lab.of("ann").post("/jobs", json={"kind": "nothing"})  # Refused: nothing was done.
    lab.of("ann").post(f"/jobs/{job_id}/cancel")
    lab.of("root").delete(f"/jobs/{job_id}")
    lab.of("ann").post("/tokens", json={"scope": "read"})
    lab.service.audit_log.flush()
    of_job = lab.of("root").get("/audit", params={"object": f"job {job_id}"}).json()["items"]
    assert [(one["user"], one["action"]) for one in of_job] == [
        ("root", "job.deleted"),
        ("ann", "job.cancelled"),
        ("ann", "job.submitted"),
    ]
    assert (of_job[2]["correlation_id"], of_job[2]["address"]) == ("from-the-test", "127.0.0.1")
    [made] = lab.of("root").get("/audit", params={"user": "ann", "action": "token."}).json()["items"]
    assert made["action"] == "token.created"
    page = lab.of("root").get("/audit", params={"limit": 1}).json()
    assert lab.of("root").get("/audit", params={"cursor": page["next"]}).status_code == 200


def test_an_entry_that_an_outage_holds_back_comes_afterwards(lab: Lab) -> None:
    job_id = submitted(lab.of("ann"))["id"]
    with lab.stack.away("store"):
        lab.service.audit_log.flush()
    lab.service.audit_log.flush()
    actions = [one.action for one in lab.stack.store.audit(object=f"job {job_id}").entries]
    assert actions == ["job.submitted"]


def test_there_is_no_first_admin_without_a_file_for_the_token(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_admin, "read", lambda _: None)
    monkeypatch.setattr(wiring, "job_store", lambda *_, **__: lab.stack.store)
    file = tmp_path / "token"
    arguments = ["--name", "boss", "--file", str(file)]
    assert first_admin.main(arguments) == 1  # There is an admin.
    assert not file.exists()
    file.write_text("taken")
    assert first_admin.main([*arguments, "--anyway"]) == 1
    assert "boss" not in [user.name for user in lab.stack.store.users()]
    file.unlink()
    assert first_admin.main([*arguments, "--anyway"]) == 0
    with lab.with_token(file.read_text().strip()) as boss:
        assert boss.get("/users").status_code == 200


def test_without_accounts_everybody_is_an_admin_without_a_name(stack: Stack) -> None:
    assert stack.http.get("/whoami").json() == {
        "accounts": False,
        "user": None,
        "role": "admin",
        "scope": "admin",
        "projects": ["default"],
        "token": None,
        "expires_at": None,
    }
    problem(stack.http.post("/users", json={"name": "ann"}), 409, "accounts-off")
    problem(stack.http.get("/audit"), 409, "accounts-off")
    document = problem(stack.http.post("/jobs", json={**JOB, "project": "a"}), 422, "invalid-request")
    assert pointers(document) == ["/project"]
    job = stack.http.post("/jobs", json={**JOB, "project": "default"}).json()
    assert (job["owner"], job["project"]) == (None, "default")
    assert [one["id"] for one in stack.http.get("/jobs").json()["items"]] == [job["id"]]
