"""The service around the jobs: catalog, health, problems, documentation, its process."""

import hashlib
import html
import json
import os
import signal
import subprocess
import sys
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as examples
from hypothesis import strategies as st

from api.app import build
from api.problems import MalformedBody, classes_of_errors, status_of
from api.submissions import EXAMPLES, parse
from core.adapters.wiring import object_store
from core.algorithms.catalog import ALGORITHMS
from core.environments.catalog import ENVIRONMENTS
from core.errors import GaitwayError, Rejected
from core.jobs.attempts import claim_attempt, new_secret
from core.jobs.job import Artifact
from core.jobs.spec import JOB_SPEC
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from core.settings import ApiSettings, StoreSettings, WorkerSettings
from core.storage import keys
from gaitway import Client
from tests.api.conftest import ARTIFACT, NOON, Attempt, Stack, job, serving
from tests.api.problems import problem


def test_an_environment_tells_what_a_job_may_say_about_it(stack: Stack) -> None:
    ant = stack.http.get("/environments/ant").json()
    assert (ant["observation_size"], ant["action_size"], ant["dt"], ant["episode_length"]) == (
        27,
        8,
        0.05,
        1000,
    )
    assert ant["cameras"][0] == "track"
    assert ant["cameras"].count("track") == 1
    assert ant["options"]["properties"]["healthy_reward"]["default"] == 1.0
    assert ant["tuned"]["ppo"]["cpu"]["num_envs"] == 256


def test_an_environment_names_the_numbers_of_its_observation_and_action(stack: Stack) -> None:
    ant = stack.http.get("/environments/ant").json()
    # The height, a quaternion and eight angles; velocities along three axes, about three, and of the joints.
    assert [(one["name"], one["start"], one["size"], one["unit"]) for one in ant["observation"]] == [
        ("qpos", 0, 1, "m"),
        ("qpos", 1, 4, "1"),
        ("qpos", 5, 8, "rad"),
        ("qvel", 13, 3, "m/s"),
        ("qvel", 16, 11, "rad/s"),
    ]
    first = ant["action"][0]
    assert (first["name"], first["low"], first["high"]) == ("hip_4", -1.0, 1.0)
    shown = {"options": '{"exclude_current_positions_from_observation": false}'}
    whole = stack.http.get("/environments/ant", params=shown).json()
    assert whole["observation"][0]["components"] == ["root x", "root y", "root z"]
    assert whole["observation_size"] == 29
    # They would make the list long.
    assert "observation" not in stack.http.get("/environments").json()["items"][0]
    own = stack.http.get("/environments/mjcf").json()
    assert (own["observation"], own["parts"]) == ([], {})
    robot = stack.http.get("/environments/go1").json()
    feet = robot["options"]["properties"]["feet"]["default"]
    assert set(feet) < set(robot["parts"]["bodies"])
    assert (len(robot["parts"]["joints"]), robot["parts"]["keyframes"]) == (12, ["home"])
    posture = robot["options"]["$defs"]["Posture"]["properties"]["weight"]
    assert (posture["default"], posture["examples"]) == (1.0, [0.1])


def test_an_environment_is_shown_under_the_options_that_a_job_would_give(stack: Stack) -> None:
    star = "/environments/brittle_star"
    plain, steered = (
        stack.http.get(star, params=params).json() for params in ({}, {"options": '{"control": "cpg"}'})
    )
    assert (plain["action_size"], steered["action_size"]) == (50, 36)
    # What fits a pattern generator and a table is not what fits single joints.
    assert plain["defaults"]["ppo"]["cpu"]["action_repeat"] == 1
    assert steered["defaults"]["ppo"]["cpu"]["action_repeat"] == 10
    assert plain["defaults"]["sac"]["cpu"]["episode_length"] == plain["episode_length"]
    # A table takes the generator where a job does not say how the star is controlled, and says so.
    assert plain["environment_options"] == {kind: {"control": "cpg"} for kind in ("dqn", "q_learning")}
    for kind in ("dqn", "q_learning"):
        assert plain["defaults"][kind] == steered["defaults"][kind]
    assert steered["environment_options"] == {}
    by_joints = stack.http.get(star, params={"options": '{"control": "joints"}'}).json()
    assert {"dqn", "q_learning"}.isdisjoint(by_joints["defaults"])
    assert by_joints["environment_options"] == {}
    assert steered["defaults"]["q_learning"]["cpu"]["state_discretizer"] == {"kind": "arm_towards_target"}


def test_an_environment_says_which_engines_cannot_run_it_under_these_options(stack: Stack) -> None:
    options = '{"walls": "contacts", "num_segments_per_arm": 12}'
    star = stack.http.get("/environments/brittle_star", params={"options": options}).json()["cannot_run"]
    assert set(star) == {"mjx"}
    assert "MJX does not compile in time" in star["mjx"]
    options = '{"walker": "ant", "arena": "empty"}'
    ant = stack.http.get("/environments/corridor", params={"options": options}).json()
    assert ant["cannot_run"] == {}


@pytest.mark.parametrize(
    ("options", "pointer", "sentence"),
    [
        ("[]", "/options", "not a JSON object"),
        ('{"control": "mind"}', "/options/control", "'joints'"),
        ('{"controls": "cpg"}', "/options/controls", "no such option"),
    ],
)
def test_wrong_options_are_refused_with_their_place(
    options: str, pointer: str, sentence: str, stack: Stack
) -> None:
    document = problem(
        stack.http.get("/environments/brittle_star", params={"options": options}), 422, "invalid-request"
    )
    assert document["errors"][0]["pointer"] == pointer
    assert sentence in document["detail"]


def test_every_environment_of_the_catalog_is_listed(stack: Stack) -> None:
    listed = stack.http.get("/environments").json()
    assert {item["id"] for item in listed["items"]} == set(ENVIRONMENTS)
    assert listed["next"] is None


def test_the_environments_of_a_package_are_listed_by_themselves(stack: Stack) -> None:
    listed = stack.http.get("/environments", params={"family": "playground"}).json()["items"]
    assert {item["family"] for item in listed} == {"playground"}
    cheetah = stack.http.get("/environments/playground/CheetahRun").json()
    assert cheetah.pop("defaults")["ppo"]["gpu"]["num_envs"] == 2048
    assert cheetah.pop("observation") == [
        {
            "name": "observation",
            "start": 0,
            "size": 17,
            "unit": None,
            "low": None,
            "high": None,
            "components": [],
        }
    ]
    assert cheetah.pop("action")[0]["size"] == 6
    assert (cheetah.pop("critic"), cheetah.pop("parts")) == ([], {})
    assert "eval/episode_reward" in cheetah.pop("metrics")["sac"]
    assert cheetah in listed
    assert (cheetah["observation_size"], cheetah["tuned"]["ppo"]["gpu"]["num_envs"]) == (17, 2048)
    assert stack.http.get("/environments/brax%2Fant").json()["options"]["properties"]["backend"]
    document = problem(stack.http.get("/environments/playground/Go1Getup"), 404, "environment-not-found")
    assert "Menagerie" in document["detail"]


def test_an_unknown_environment_names_the_nearest(stack: Stack) -> None:
    document = problem(stack.http.get("/environments/antt"), 404, "environment-not-found")
    assert "'ant'" in document["detail"]
    assert "ant" in document["environments"]


def test_every_algorithm_has_a_schema(stack: Stack) -> None:
    items = stack.http.get("/algorithms").json()["items"]
    assert [item["kind"] for item in items] == list(ALGORITHMS)
    assert items[0]["parameters"]["properties"]["discounting"]["maximum"] == 1.0


def test_workers_are_listed_while_they_are_heard_of(stack: Stack) -> None:
    worker = WorkerInfo(name="w", host="h", pid=1, device="cpu", started_at=NOON, seen_at=NOON)
    stack.store.announce(worker, timedelta(minutes=1))
    items = stack.http.get("/workers").json()["items"]
    assert [(item["name"], item["device"], item["job"]) for item in items] == [("w", "cpu", None)]


def test_a_worker_has_all_jobs_whose_attempts_run_there(stack: Stack) -> None:
    """One of its four has ended and one is queued again; another worker has a fifth."""
    first, second, third, fourth = (Attempt(stack, job(f"{number:012x}-0000000000")) for number in range(4))
    second.end()
    third.claim.give_back(Reason.DEVICE_HELD, "It is held.")
    Attempt(stack, job("000000000004-0000000000"), worker="worker-2")
    for name in ("worker-1", "worker-2", "worker-3"):
        worker = WorkerInfo(name=name, host="h", pid=1, device="cpu", started_at=NOON, seen_at=NOON)
        stack.store.announce(worker, timedelta(minutes=1))
    items = stack.http.get("/workers").json()["items"]
    assert [item["jobs"] for item in items] == [[first.id, fourth.id], ["000000000004-0000000000"], []]


def test_the_slots_that_are_wanted_are_counted_by_kind(stack: Stack) -> None:
    for number, resources in enumerate(({}, {"accelerator": "cpu"}, {"gpus": 4})):
        stack.store.add(job(f"{number:012x}-0000000000", resources=resources))
    whole = stack.http.get("/slots").json()
    kinds = [(one["accelerator"], one["gpus"], one["hosts"], one["queued"]) for one in whole["items"]]
    assert kinds == [("any", 0, 1, 1), ("cpu", 0, 1, 1), ("gpu", 4, 1, 1)]
    on_cpu = stack.http.get("/slots", params={"counted_as": "cpu", "accelerator": "cpu"}).json()
    assert (on_cpu["queued"], on_cpu["running"], on_cpu["oldest_queued_s"] > 0) == (2, 0, True)
    none = stack.http.get("/slots", params={"gpus": 8}).json()
    assert none == {"items": [], "queued": 0, "running": 0, "wanted": 0, "oldest_queued_s": None}
    assert on_cpu["wanted"] == 2
    with Client(f"http://127.0.0.1:{stack.port}") as client:
        assert [one.queued for one in client.slots(counted_as="gpu").items] == [1, 1, 1]


def test_a_service_is_ready_while_both_stores_answer(stack: Stack) -> None:
    assert stack.http.get("/readyz").json() == {"status": "ok"}
    with stack.away("store"):
        answer = stack.http.get("/readyz")
        problem(answer, 503, "records-unavailable")
        assert answer.headers["Retry-After"] == "7"
        assert stack.http.get("/healthz").json() == {"status": "ok"}
    with stack.away("objects"):
        problem(stack.http.get("/readyz"), 503, "storage-unavailable")
    with stack.away("queue"):  # What it misses, the reconciler tells it.
        assert stack.http.get("/readyz").json() == {"status": "ok"}


@pytest.mark.parametrize(
    "error", sorted(classes_of_errors(), key=lambda error: error.__name__), ids=lambda error: error.__name__
)
def test_every_error_has_a_status_and_a_page(stack: Stack, error: type[GaitwayError]) -> None:
    assert 400 <= status_of(error) < 600
    page = stack.http.get(f"/problems/{error.code}")
    assert page.status_code == 200
    assert html.escape(error.title) in page.text


def test_every_code_belongs_to_one_error() -> None:
    codes = [error.code for error in classes_of_errors() if "code" in vars(error)]
    assert len(codes) == len(set(codes))


def test_a_defect_is_answered_without_its_internals(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    def defect(**_: object) -> None:
        raise ZeroDivisionError("secret internals")

    monkeypatch.setattr(stack.store, "list_workers", defect)
    answer = stack.http.get("/workers", headers={"X-Request-ID": "mine-1"})
    assert problem(answer, 500, "unexpected-error")["correlation_id"] == "mine-1"
    assert answer.headers["X-Request-ID"] == "mine-1"
    assert "secret" not in answer.text


@pytest.mark.parametrize("sent", ["", "x" * 65, "a b", '{"x":1}'])
def test_a_correlation_id_that_could_do_harm_is_replaced(stack: Stack, sent: str) -> None:
    answer = stack.http.get("/healthz", headers={"X-Request-ID": sent})
    assert answer.headers["X-Request-ID"] != sent
    assert len(answer.headers["X-Request-ID"]) == 16


def test_every_operation_is_documented_with_its_problems(stack: Stack) -> None:
    document = stack.http.get("/openapi.json").json()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            assert operation["summary"], path
            assert operation["description"], path
            refusals = {
                status: answer for status, answer in operation["responses"].items() if status[0] not in "23"
            }
            assert refusals, (path, method)
            for answer in refusals.values():
                assert list(answer["content"]) == ["application/problem+json"], (path, method)
    body = document["paths"]["/jobs"]["post"]["requestBody"]["content"]["application/json"]
    assert body["schema"] == {"$ref": "#/components/schemas/JobSpec"}
    assert set(document["paths"]["/jobs"]["post"]["responses"]) >= {
        "202",
        "400",
        "409",
        "413",
        "415",
        "422",
        "503",
    }


def test_every_reference_of_the_documentation_leads_somewhere(stack: Stack) -> None:
    text = stack.http.get("/openapi.json").text
    schemas = json.loads(text)["components"]["schemas"]
    assert {part.split('"')[0] for part in text.split("#/components/schemas/")[1:]} <= set(schemas)
    assert "HTTPValidationError" not in schemas


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_the_examples_are_valid(name: str) -> None:
    assert parse(json.dumps(EXAMPLES[name]["value"]).encode(), JOB_SPEC).kind in ("train", "rollout")


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
_FIELDS = [
    "environment",
    "algorithm",
    "video",
    "seed",
    "labels",
    "policy",
    "resume_from",
    "name",
    "timeout_s",
    "physics",
    "randomization",
    "checkpoints",
    "x",
]
_BODIES = st.builds(
    lambda kind, fields: {"kind": kind, "environment": "ant", **fields},
    st.sampled_from(["train", "rollout", "x"]) | _JSON,
    st.dictionaries(st.sampled_from(_FIELDS), _JSON, max_size=4),
)


@examples(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(body=_BODIES | _JSON)
def test_no_document_does_more_than_be_refused(body: Any) -> None:
    try:
        parse(json.dumps(body).encode(), JOB_SPEC)
    except (Rejected, MalformedBody) as error:
        places = error.problems
        assert places
        assert all(place.detail for place in places)
        for place in places:
            assert _leads_somewhere(place.pointer, body), (place.pointer, body)


@examples(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    derandomize=True,
)
@given(body=st.binary(max_size=64) | _BODIES.map(lambda body: json.dumps(body).encode()))
def test_no_body_makes_the_service_fail(stack: Stack, body: bytes) -> None:
    answer = stack.http.post("/jobs", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code in (202, 400, 422)


def _leads_somewhere(pointer: str, document: Any) -> bool:
    """Whether the place exists, or at least the object that lacks it."""
    *parents, _ = [part.replace("~1", "/").replace("~0", "~") for part in pointer.split("/")[1:]] or [""]
    for part in parents:
        document = document[int(part)] if isinstance(document, list) else document[part]
    return True


def test_the_process_is_small_without_a_numerical_stack_and_ends_on_sigterm(tmp_path: Path) -> None:
    probe = (
        "import sys, api.app, core.adapters.wiring\n"
        "found = {'jax', 'jaxlib', 'mujoco', 'numpy', 'brax', 'av'} & set(sys.modules)\n"
        "assert not found, found\n"
        "from api.main import main; main(['--port', '0'])"
    )
    environment = {
        "GAITWAY_DATABASE_URL": f"postgresql://gaitway@/gaitway?host={tmp_path}",
        "GAITWAY_REDIS_URL": f"unix://{tmp_path}/none.sock",
        "GAITWAY_S3_ENDPOINT": "127.0.0.1:9",
        "GAITWAY_S3_ACCESS_KEY": "key",
        "GAITWAY_S3_SECRET_KEY": "secret",
        "GAITWAY_S3_SECURE": "false",
    }
    with subprocess.Popen(
        [sys.executable, "-c", probe], stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    ) as process:
        try:
            assert process.stdout is not None
            told = map(json.loads, process.stdout)  # first that no store is there, then where it listens
            port = next(line["port"] for line in told if "port" in line)
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20) as http:
                assert http.get("/healthz").status_code == 200
                assert http.get("/openapi.json").status_code == 200
                problem(http.get("/readyz"), 503, "records-unavailable")
                status = Path(f"/proc/{process.pid}/status")
                if status.exists():  # elsewhere than on Linux there is nothing to read
                    resident = next(
                        line for line in status.read_text().splitlines() if line.startswith("VmRSS")
                    )
                    assert int(resident.split()[1]) / 1024 < 130
            process.send_signal(signal.SIGTERM)
            assert process.wait(20) in (0, -signal.SIGTERM)
        finally:
            process.kill()


def test_the_service_works_over_the_real_stores(settings: WorkerSettings) -> None:
    stores = settings.model_dump(include=set(StoreSettings.model_fields))
    app = build(ApiSettings.model_validate(stores))
    with (
        closing(app.state.service.store),
        serving(app) as port,
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20, verify=False) as http,  # noqa: S501
    ):
        assert http.get("/readyz").status_code == 200
        headers = {"Idempotency-Key": "real"}
        ids = {
            http.post("/jobs", json={"kind": "train", "environment": "ant"}, headers=headers).json()["id"]
            for _ in range(2)
        }
        assert len(ids) == 1
        job_id = ids.pop()
        store, objects = app.state.service.store, object_store(settings)
        lease, secret = timedelta(minutes=1), new_secret()
        held = claim_attempt(job_id, 1, "w", store=store, objects=objects, lease=lease, secret=secret)
        assert held is not None
        digest = hashlib.sha256(ARTIFACT).hexdigest()
        video = Artifact(
            name="video.mp4", role="video", media_type="video/mp4", size=len(ARTIFACT), sha256=digest,
            key=keys.artifact(job_id, 1, digest, "video.mp4"),
        )  # fmt: skip
        objects.put(video.key, ARTIFACT)
        held.start(device="cpu")
        held.publish((video,), keep_checkpoints=1)
        held.end(JobStatus.SUCCEEDED, Reason.COMPLETED, "Done.")
        assert http.get(f"/jobs/{job_id}/video").content == ARTIFACT
        part = http.get(f"/jobs/{job_id}/video", headers={"Range": "bytes=1048570-1048579"})
        assert part.content == ARTIFACT[1048570:1048580]
        events = http.get(f"/jobs/{job_id}/events").text
        assert [line for line in events.splitlines() if "status" in line][-1].count("succeeded") == 1
        assert [item["id"] for item in http.get("/jobs?status=succeeded").json()["items"]] == [job_id]
        assert http.delete(f"/jobs/{job_id}").status_code == 204
        problem(http.get(f"/jobs/{job_id}/video"), 404, "job-not-found")
