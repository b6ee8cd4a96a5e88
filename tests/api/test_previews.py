"""Stills over HTTP, with the worker's part played by the test."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

import httpx
import pytest

from api.routes import previews as route
from core.jobs.queue import queue_names
from core.jobs.workers import WorkerInfo
from core.previews import library
from core.previews.record import PreviewRequest
from core.rendering.request import RenderFailure
from tests.api.conftest import NOON, Stack
from tests.api.problems import pointers, problem
from tests.api.test_models import DESCRIPTION, send
from tests.api.test_models import worker as validating_worker

ANT = "/environments/ant/preview"


def announced(stack: Stack, device: str = "cpu") -> None:
    """A worker that is heard of, and does nothing."""
    info = WorkerInfo(
        name="w", host="h", pid=1, device=device, queues=queue_names(device), started_at=NOON, seen_at=NOON
    )
    stack.store.announce(info, timedelta(hours=1))


@contextmanager
def drawing_worker(stack: Stack, failure: RenderFailure | None = None) -> Iterator[list[PreviewRequest]]:
    """A worker whose stills name their camera, or that fails; what it was asked for."""
    idle, drawn = threading.Event(), list[PreviewRequest]()

    def work() -> None:
        while not idle.is_set():
            if wanted := stack.queue.take_preview():
                drawn.append(wanted)
                if failure is not None:
                    library.keep_failure(wanted, failure, stack.objects, NOON)
                else:
                    pictures = [str(camera).encode() for camera in wanted.cameras]
                    library.keep(wanted, pictures, stack.objects, NOON)
            time.sleep(0.01)

    announced(stack)
    thread = threading.Thread(target=work)
    thread.start()
    yield drawn
    idle.set()
    thread.join()


def test_there_is_a_still_from_each_camera_drawn_once_for_everybody(stack: Stack) -> None:
    with drawing_worker(stack) as drawn:
        listed = stack.http.get(ANT)
        again = stack.http.get(ANT, params={"options": '{"healthy_reward": 1.0}'})
    assert listed.status_code == again.status_code == 200
    document = listed.json()
    assert (document["status"], document["environment"]) == ("ready", "ant")
    # The ant's model has a camera of the name that is ours: it is reached by its number.
    assert [still["camera"] for still in document["stills"]] == document["cameras"] == ["track", 0]
    for still in document["stills"]:
        picture = stack.http.get(still["href"])
        assert picture.content == str(still["camera"]).encode()
        assert picture.headers["content-type"] == "image/png"
        assert "ant-" in picture.headers["content-disposition"]
        known = stack.http.get(still["href"], headers={"If-None-Match": picture.headers["etag"]})
        assert known.status_code == 304
    # Options that are the defaults make no other picture.
    assert again.json()["stills"][0]["sha256"] == document["stills"][0]["sha256"]
    assert len(drawn) == 1


@pytest.mark.parametrize(
    ("environment", "cameras"),
    [("playground/CheetahRun", ["track", "side", "back"]), ("brax/ant", ["track", 0])],
)
def test_an_environment_of_another_package_has_stills_under_its_whole_id(
    environment: str, cameras: list[str | int], stack: Stack
) -> None:
    here = f"/environments/{environment}"
    with drawing_worker(stack) as drawn:
        document = stack.http.get(f"{here}/preview").json()
        last = stack.http.get(f"{here}/preview", params={"camera": str(cameras[-1])})
        escaped = stack.http.get(f"/environments/{environment.replace('/', '%2F')}/preview")
    assert (document["environment"], document["links"]["self"]) == (environment, f"{here}/preview")
    assert [still["camera"] for still in document["stills"]] == cameras
    assert stack.http.get(document["stills"][-1]["href"]).content == last.content == str(cameras[-1]).encode()
    assert f"{environment.replace('/', '-')}-{cameras[-1]}.png" in last.headers["content-disposition"]
    assert escaped.json()["stills"][0]["sha256"] == document["stills"][0]["sha256"]
    assert len(drawn) == 1
    # Neither route hides the other.
    assert stack.http.get(here).json()["id"] == environment
    assert problem(stack.http.get("/environments/brax/pig/preview"), 404, "environment-not-found")


def test_options_and_size_make_other_stills_with_addresses_that_keep_them(stack: Stack) -> None:
    asked = {
        "options": '{"walker": "rodent"}',
        "show": ["joints", "contacts"],
        "width": 320,
        "height": 200,
    }
    with drawing_worker(stack) as drawn:
        document = stack.http.get("/environments/corridor/preview", params=asked).json()
        assert stack.http.get(document["stills"][-1]["href"]).content == b"walker/egocentric"
        assert stack.http.get("/environments/corridor/preview", params={"camera": "5"}).status_code == 422
        by_number = stack.http.get("/environments/corridor/preview", params={**asked, "camera": "4"})
    assert by_number.content == b"walker/egocentric"
    (wanted,) = drawn
    assert (wanted.width, wanted.height, wanted.options["walker"]) == (320, 200, "rodent")
    assert wanted.show == ["joints", "contacts"]
    assert "show=joints&show=contacts" in document["stills"][0]["href"]
    assert wanted.cameras == document["cameras"] == [
        "track", "walker/back", "walker/side", "walker/side_alt", "walker/top", "walker/egocentric"
    ]  # fmt: skip


def test_while_all_workers_are_busy_the_answer_says_where_to_ask_again(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.05)
    announced(stack)
    first, second = (stack.http.get(ANT, params={"camera": "track"}) for _ in range(2))
    assert (first.status_code, second.status_code) == (202, 202)
    assert (first.headers["location"], first.headers["retry-after"]) == (f"{ANT}?camera=track", "2")
    assert (first.json()["status"], first.json()["stills"]) == ("drawing", [])
    assert stack.queue.num_previews() == 1
    # What the queue has lost is asked for again.
    stack.queue.take_preview()
    stack.http.get(first.headers["location"])
    assert stack.queue.num_previews() == 1


@pytest.mark.parametrize("device", [None, "gpu:0,1"])
def test_without_a_worker_that_could_draw_the_answer_says_so(stack: Stack, device: str | None) -> None:
    if device:  # It takes nothing but what asks for two GPUs.
        announced(stack, device)
    answer = stack.http.get(ANT)
    assert "No worker is available" in problem(answer, 503, "no-worker")["detail"]
    assert "retry-after" in answer.headers
    assert stack.queue.num_previews() == 0


def test_previews_do_not_fill_the_queue(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(route, "_TIMEOUT_S", 0.0)
    announced(stack)
    codes = [stack.http.get(ANT, params={"width": 16 + number}).status_code for number in range(18)]
    assert codes == [202] * 16 + [503] * 2


@pytest.mark.parametrize(
    ("reason", "status", "code"),
    [("no_gl", 503, "nothing-draws"), ("bad_request", 422, "invalid-request")],
)
def test_what_kept_the_worker_from_it_is_told_and_tried_again_by_the_next(
    stack: Stack, reason: Any, status: int, code: str
) -> None:
    with drawing_worker(stack, RenderFailure(reason=reason, message="It went wrong.")):
        assert problem(stack.http.get(ANT), status, code)["detail"] == "It went wrong."
    assert stack.is_empty()
    with drawing_worker(stack):
        assert stack.http.get(ANT).status_code == 200


@pytest.mark.parametrize(
    ("path", "asked", "pointer", "sentence"),
    [
        (ANT, {"options": '{"legs": 6}'}, "/options/legs", "there is no such option"),
        (ANT, {"options": "legs=6"}, "/options", "not a JSON object"),
        (ANT, {"options": "[1]"}, "/options", "not a JSON object"),
        (ANT, {"camera": "side"}, "/camera", "known are track"),
        (ANT, {"camera": "7"}, "/camera", "by number 0 to 0"),
        (ANT, {"width": 5000}, "/width", "1920"),
        (ANT, {"size": 3}, "/size", "not a field"),
        (
            "/environments/mjcf/preview",
            {"options": json.dumps({"model": "sha256:" + "0" * 64})},
            "/options/model",
            "There is no model",
        ),
        ("/environments/mjcf/preview", {}, "/options/model", "required"),
    ],
)
def test_what_a_job_would_be_refused_for_is_refused_here(
    path: str, asked: dict[str, Any], pointer: str, sentence: str, stack: Stack
) -> None:
    announced(stack)
    document = problem(stack.http.get(path, params=asked), 422, "invalid-request")
    assert pointers(document) == [pointer]
    assert sentence in document["detail"]
    assert stack.queue.num_previews() == 0


def test_an_environment_that_there_is_not_is_not_found(http: httpx.Client) -> None:
    document = problem(http.get("/environments/antt/preview"), 404, "environment-not-found")
    assert "Did you mean 'ant'" in document["detail"]


def test_the_stills_of_a_users_model_go_with_it(stack: Stack) -> None:
    with validating_worker(stack, status="ready", description=DESCRIPTION):
        model = send(stack.http).json()["id"]
    asked = {"options": json.dumps({"model": model})}
    with drawing_worker(stack):
        document = stack.http.get("/environments/mjcf/preview", params=asked).json()
    assert document["cameras"] == ["track", "above"]
    assert stack.http.delete(f"/models/{model}").status_code == 204
    assert stack.is_empty()
