"""Models over HTTP, with the worker's part played by the test; and jobs that name them."""

import json
import socket
import tempfile
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import mujoco
import pytest
from typer.testing import CliRunner

from api import uploads as route
from core.environments.mjcf.archive import examine
from core.environments.terms.describe import inventory
from core.jobs.reconciliation import Reconciler
from core.physics.availability import beyond_compiled
from core.storage import keys
from core.uploads import library
from core.user_models.record import Description
from gaitway.cli.main import app
from tests.api.conftest import Stack
from tests.api.problems import problem
from tests.models import identity
from tests.unit.environments.mjcf.probe import XML
from tests.unit.environments.mjcf.test_archive import zipped

DESCRIPTION = Description(
    inventory=inventory(mujoco.MjModel.from_xml_string(XML.decode())),
    engines={
        "native": None,
        "compiled": beyond_compiled("its geom 'rock' is a mesh"),
        "mjx": "Ellipsoids and boxes are not implemented.",
        "warp": None,
    },
    trials={"native": "the same to 1e-7 after 1 s"},
    code_seconds={"native": 2.0},
    auto={"cpu": "native", "gpu": "warp"},
    physics_steps_per_second=1000.0,
    settled_height=0.5,
    complete=True,
)


def send(http: httpx.Client, body: bytes = XML, media_type: str = "application/xml") -> httpx.Response:
    return http.post("/models", content=body, headers={"Content-Type": media_type})


@contextmanager
def worker(stack: Stack, **found: Any) -> Iterator[None]:
    """A worker that finds this in every model."""
    idle = threading.Event()

    def work() -> None:
        while not idle.is_set():
            if sent := stack.queue.take_upload():
                _, model_id = sent
                record = library.find(model_id, stack.store.models)
                stack.store.models.settle(record.model_copy(update=found))
            time.sleep(0.01)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:  # Of a test that fails, too: pytest would wait for the thread.
        idle.set()
        thread.join()


@pytest.fixture
def model(stack: Stack) -> str:
    """A model that is ready."""
    with worker(stack, status="ready", description=DESCRIPTION):
        return send(stack.http).json()["id"]


def job(model: str, **options: Any) -> dict[str, Any]:
    return {"kind": "train", "environment": {"id": "mjcf", "options": {"model": model, **options}}}


def test_a_model_is_answered_with_what_is_in_it(stack: Stack) -> None:
    with worker(stack, status="ready", description=DESCRIPTION):
        answer = send(stack.http)
    assert answer.status_code == 201
    document = answer.json()
    assert answer.headers["location"] == f"/models/{document['id']}" == document["links"]["self"]
    assert document["id"] == identity(XML)
    assert document["description"]["inventory"]["sizes"]["nu"] == 1
    engines = document["description"]["engines"]
    assert engines["mjx"] == "Ellipsoids and boxes are not implemented."
    assert "its geom 'rock' is a mesh" in engines["compiled"]
    assert stack.http.get(f"/models/{document['id']}").json() == document
    assert stack.http.get("/models").json()["items"] == [document]


def test_a_model_has_the_name_that_it_was_sent_by_and_can_be_found_by_it(stack: Stack) -> None:
    with worker(stack, status="ready", description=DESCRIPTION):
        headers = {"Content-Type": "application/xml"}
        first = stack.http.post("/models", content=XML, headers=headers, params={"name": "my dog"}).json()
        other = send(stack.http, XML + b"\n").json()
    assert (first["name"], other["name"]) == ("my dog", None)
    assert stack.http.get("/models", params={"name": "my dog"}).json()["items"] == [first]
    again = stack.http.post("/models", content=XML, headers=headers, params={"name": "cat"})
    assert (again.status_code, again.json()["name"]) == (200, "cat")
    assert stack.http.get(f"/models/{first['id']}").json()["name"] == "cat"
    assert stack.http.get("/models", params={"name": "my dog"}).json()["items"] == []


@pytest.mark.parametrize("name", ["", "x" * 101, "two\nlines", "\x1b[2J"])
def test_a_name_of_a_model_is_short_and_of_one_line(name: str, stack: Stack) -> None:
    headers = {"Content-Type": "application/xml"}
    answer = stack.http.post("/models", content=XML, headers=headers, params={"name": name})
    document = problem(answer, 422, "invalid-request")
    assert [error["pointer"] for error in document["errors"]] == ["/name"]
    assert stack.is_empty()


def test_the_main_document_of_a_zip_is_part_of_the_model(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.01)
    body, headers = zipped({"a.xml": XML, "b.xml": XML}), {"Content-Type": "application/zip"}

    def sent(main: str) -> dict[str, Any]:
        return stack.http.post("/models", content=body, headers=headers, params={"main": main}).json()

    ids = [sent(main)["id"] for main in ("a.xml", "b.xml", "a.xml")]
    assert ids[0] == ids[2] != ids[1]
    stored = stack.objects.get(keys.model_source(ids[1]))
    assert (identity(stored), examine(stored).main) == (ids[1], "b.xml")
    assert sent("a.xml")["size"] == len(stored)


@pytest.mark.parametrize(
    ("body", "main", "code", "sentence"),
    [
        (XML, "a.xml", "invalid-request", "names a document of a zip"),
        (zipped({"a.xml": XML}), "x" * 1001, "invalid-request", "at most 1,000 are allowed"),
        (b"PK\x03\x04 and no zip", "a.xml", "bad-model", "no directory at its end"),
    ],
)
def test_a_main_document_that_cannot_be_named_is_refused_at_once(
    body: bytes, main: str, code: str, sentence: str, stack: Stack
) -> None:
    headers = {"Content-Type": "application/zip" if body.startswith(b"PK") else "application/xml"}
    answer = stack.http.post("/models", content=body, headers=headers, params={"main": main})
    document = problem(answer, 422, code)
    assert sentence in document["detail"]
    assert stack.is_empty()


def test_a_model_that_can_be_used_is_answered_before_each_engine_was_tried(stack: Stack) -> None:
    described = DESCRIPTION.model_copy(update={"engines": {"native": None}, "complete": False})
    began = time.monotonic()
    with worker(stack, status="ready", description=described):
        answer = send(stack.http)
    assert time.monotonic() - began < route._TIMEOUT_S
    assert (answer.status_code, answer.headers["retry-after"]) == (201, "2")
    assert answer.json()["description"]["engines"] == {"native": None}


def test_the_same_bytes_are_the_same_model(stack: Stack, model: str) -> None:
    again = send(stack.http)
    assert (again.status_code, again.json()["id"]) == (200, model)
    assert not stack.queue.contains_upload("model", model)


def test_a_slow_validation_is_asked_for_elsewhere(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.05)
    answer = send(stack.http)
    assert (answer.status_code, answer.headers["retry-after"]) == (202, "2")
    model_id = answer.json()["id"]
    assert stack.http.get(answer.headers["location"]).json()["status"] == "validating"
    refused = problem(stack.http.post("/jobs", json=job(model_id)), 422, "invalid-request")
    assert "still being validated" in refused["detail"]
    assert send(stack.http).status_code == 202
    # Whatever the queue has lost is asked for again, at the second look that misses it.
    assert stack.queue.take_upload() == ("model", model_id)
    reconciler = Reconciler(stack.store, stack.queue, timedelta(seconds=15))
    assert [reconciler.run_once(), reconciler.run_once()] == [0, 1]
    assert stack.queue.contains_upload("model", model_id)


def test_a_refused_model_leaves_nothing_behind(stack: Stack) -> None:
    with worker(stack, status="refused", message="The model has no actuators."):
        document = problem(send(stack.http), 422, "bad-model")
    assert document["detail"] == "The model has no actuators."
    assert stack.is_empty()


@pytest.mark.parametrize(
    ("body", "media_type", "sentence"),
    [
        (XML, "application/zip", "The file is not a zip"),
        (zipped({"model.xml": XML}), "text/xml", "The file is a zip"),
    ],
)
def test_what_is_not_what_it_is_called_is_refused_at_once(
    body: bytes, media_type: str, sentence: str, stack: Stack
) -> None:
    document = problem(send(stack.http, body, media_type), 422, "bad-model")
    assert sentence in document["detail"]
    assert stack.is_empty()


@pytest.mark.parametrize(
    ("body", "media_type"),
    [
        (b"", "application/xml"),
        (b'<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "application/xml"),
        (b"PK\x03\x04 and no zip", "application/zip"),
        (zipped({"model.xml": XML, "m.stl": b"\0" * 2**22}), "application/zip"),
    ],
)
def test_nothing_but_a_worker_looks_into_a_model(
    body: bytes, media_type: str, stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.01)
    document = send(stack.http, body, media_type).json()
    assert (document["status"], document["size"]) == ("validating", len(body))
    assert document["id"] == identity(body)
    assert stack.objects.get(keys.model_source(document["id"])) == body


def test_an_upload_is_held_on_disk_and_not_in_memory(
    stack: Stack, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.01)
    piece, seen = b"\n" * 2**20, list[int]()

    def pieces() -> Iterator[bytes]:
        tracemalloc.start()
        for _ in range(32):
            yield piece
            seen.append(sum(file.stat().st_size for file in tmp_path.iterdir()))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()

    peaks = list[int]()
    answer = stack.http.post("/models", content=pieces(), headers={"Content-Type": "application/xml"})
    assert answer.status_code == 202
    assert answer.json()["size"] == 32 * 2**20
    assert max(seen) > 16 * 2**20
    assert peaks[0] < 8 * 2**20
    assert list(tmp_path.iterdir()) == []


def test_no_more_models_wait_than_the_setting_allows(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.01)
    stack.service.settings = stack.service.settings.model_copy(update={"max_waiting_models": 2})
    bodies = [XML + b"\n" * number for number in range(3)]
    assert [send(stack.http, body).status_code for body in bodies[:2]] == [202, 202]
    answer = send(stack.http, bodies[2])
    document = problem(answer, 429, "too-many-models")
    assert document["most"] == 2
    assert answer.headers["retry-after"] == "30"
    assert len(stack.store.models.all()) == 2
    record = library.find(identity(bodies[0]), stack.store.models)
    stack.store.models.settle(record.model_copy(update={"status": "ready", "description": DESCRIPTION}))
    assert send(stack.http, bodies[2]).status_code == 202


def test_an_upload_that_is_cut_short_leaves_nothing(
    stack: Stack, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with socket.create_connection(("127.0.0.1", stack.port)) as client:
        client.sendall(
            b"POST /models HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/xml\r\n"
            b"Content-Length: 1000\r\n\r\n<mujoco>"
        )
        wait_until(lambda: stack.service.num_uploads == 1)
    wait_until(lambda: stack.service.num_uploads == 0)
    assert list(tmp_path.iterdir()) == []
    assert stack.is_empty()


def wait_until(reached: Callable[[], bool]) -> None:
    until = time.monotonic() + 10
    while not reached():
        assert time.monotonic() < until
        time.sleep(0.005)


def test_a_body_of_another_type_is_refused(stack: Stack) -> None:
    answer = send(stack.http, b"{}", "application/json")
    document = problem(answer, 415, "unsupported-media-type")
    assert "Send a model as application/xml or application/zip" in document["detail"]
    assert answer.headers["accept-post"] == "application/xml, application/zip"


def test_a_body_that_is_too_long_is_refused(stack: Stack) -> None:
    limit = stack.service.settings.max_model_bytes
    document = problem(send(stack.http, b" " * (limit + 1)), 413, "body-too-large")
    assert document["limit_bytes"] == limit
    assert stack.is_empty()


@pytest.mark.parametrize("name", ["ant", "sha256:0", "sha256:" + "0" * 64, "sha256:.."])
def test_an_unknown_model_is_not_found(name: str, stack: Stack) -> None:
    problem(stack.http.get(f"/models/{name}"), 404, "model-not-found")
    problem(stack.http.delete(f"/models/{name}"), 404, "model-not-found")


def test_a_job_may_name_a_model(stack: Stack, model: str) -> None:
    terms = {
        "reward": [{"kind": "forward_velocity", "body": "ball"}, {"kind": "control_cost", "weight": 0.05}]
    }
    assert stack.http.post("/jobs", json=job(model, **terms)).status_code == 202
    camera = {**job(model), "video": {"camera": "above"}}
    assert stack.http.post("/jobs", json=camera).status_code == 202


@pytest.mark.parametrize(
    ("changes", "pointer", "sentence"),
    [
        ({"environment": {"id": "mjcf"}}, "/environment/options/model", "required"),
        (
            job("sha256:" + "0" * 64),
            "/environment/options/model",
            "There is no model",
        ),
        ({"physics": "mjx"}, "/physics", "Ellipsoids and boxes are not implemented."),
        ({"physics": "compiled"}, "/physics", "its geom 'rock' is a mesh"),
        ({"video": {"camera": "below"}}, "/video/camera", "known are track, above"),
        (
            {"kind": "rollout", "policy": {"kind": "constant", "action": [0.0, 0.0]}},
            "/policy/action",
            "takes 1 action components; 2 were given",
        ),
    ],
)
def test_a_job_that_does_not_go_with_its_model_is_refused(
    changes: dict[str, Any], pointer: str, sentence: str, stack: Stack, model: str
) -> None:
    document = problem(stack.http.post("/jobs", json={**job(model), **changes}), 422, "invalid-request")
    assert [error["pointer"] for error in document["errors"]] == [pointer]
    assert sentence in document["detail"]


def test_a_term_that_names_what_is_not_there_is_refused_with_the_nearest(stack: Stack, model: str) -> None:
    spec = job(model, termination=[{"kind": "contact", "geoms": ["spere"]}])
    document = problem(stack.http.post("/jobs", json=spec), 422, "invalid-request")
    (error,) = document["errors"]
    assert error["pointer"] == "/environment/options/termination/0/geoms/0"
    assert error["detail"] == "The model has no geom 'spere'; did you mean 'sphere'?"


def test_a_model_stays_while_a_job_needs_it(stack: Stack, model: str) -> None:
    submitted = stack.http.post("/jobs", json=job(model)).json()["id"]
    document = problem(stack.http.delete(f"/models/{model}"), 409, "model-in-use")
    assert document["jobs"] == [submitted]
    stack.http.post(f"/jobs/{submitted}/cancel")
    assert stack.http.delete(f"/models/{model}").status_code == 204
    assert list(stack.objects.list(keys.models())) == []
    problem(stack.http.get(f"/models/{model}"), 404, "model-not-found")


def test_a_recipe_is_printed_as_a_job_that_is_accepted(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    found = {
        "recipe": {"observation": [{"kind": "joint_positions"}]},
        "recipe_notes": ["It has no keyframe."],
    }
    description = DESCRIPTION.model_copy(update=found)
    with worker(stack, status="ready", description=description):
        model = send(stack.http).json()["id"]
    shown = CliRunner().invoke(app, ["models", "show", model, "--recipe"])
    assert (shown.exit_code, shown.stderr) == (0, "It has no keyframe.\n")
    job = json.loads(shown.stdout)
    assert job["environment"]["options"]["model"] == model
    assert stack.http.post("/jobs", json={**job, "battery": None}).status_code == 202


def test_a_model_is_shown_as_its_owner_looks_at_it(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    edits = {"feet": ["arm", "ball"], "pose": {"keyframe": "home"}}
    found = {
        "recipe": {"edits": edits},
        "recipe_engines": {"native": None, "compiled": None, "mjx": "It has a box."},
    }
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update=found)):
        model = send(stack.http).json()["id"]
    lines = CliRunner().invoke(app, ["models", "show", model]).stdout.splitlines()
    assert lines[1:3] == ["  feet: arm, ball", "  pose: the keyframe 'home'"]
    engines = [line.strip() for line in lines if "as it is" in line or "edits" in line]
    assert engines[:2] == [
        "engines with the recipe's edits: native, compiled",
        "native, as it is: runs it; the same to 1e-7 after 1 s (made and tried in 2 s)",
    ]
    assert engines[2].startswith("compiled, as it is: does not run it: ")
    assert not any("still being tried" in line for line in lines)  # It is complete.
    assert lines[-1] == f"A job in which it learns to walk: gaitway models show {model} --recipe"


def test_engines_that_are_still_tried_are_named_once(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    found = {"engines": {"native": None, "compiled": "It has a mesh."}, "complete": False}
    with worker(stack, status="ready", description=DESCRIPTION.model_copy(update=found)):
        model = send(stack.http).json()["id"]
    shown = CliRunner().invoke(app, ["models", "show", model]).stdout
    assert [line for line in shown.splitlines() if "tried:" in line] == [
        "  still being tried: warp, mjx; `gaitway models show` tells it later"
    ]


def test_a_model_without_a_recipe_says_why(stack: Stack, monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    monkeypatch.setenv("GAITWAY_URL", str(stack.http.base_url))
    shown = CliRunner().invoke(app, ["models", "show", model, "--recipe"])
    assert (shown.exit_code, shown.stdout) == (1, "")
    assert "There is no recipe for this model." in shown.stderr
