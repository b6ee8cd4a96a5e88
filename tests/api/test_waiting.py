"""What `GET /jobs` tells of a job that waits: for a worker that is not there, or for the end of a pause."""

from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from typing import NoReturn

import pytest

from api.shared_reads import Turns
from api.views import job_view
from core.errors import RecordsUnavailable
from core.jobs.queue import queue_names
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from tests.api.conftest import NOON, Stack

_ANT = {"kind": "train", "environment": "ant"}
_SENTENCE = "No worker has exactly 4 GPUs: the workers here have cpu."


def test_a_job_that_nobody_can_take_says_so_until_somebody_can(stack: Stack) -> None:
    announce(stack, "cpu")
    job = submit(stack, gpus=4)
    assert stack.http.get(f"/jobs/{job}").json()["waiting_for"] == _SENTENCE
    other = stack.http.post("/jobs", json=_ANT).json()["id"]
    listed = stack.http.get("/jobs").json()["items"]
    assert {item["id"]: item["waiting_for"] for item in listed} == {job: _SENTENCE, other: None}
    announce(stack, "gpu:0-3")
    assert stack.http.get(f"/jobs/{job}").json()["waiting_for"] is None


@pytest.mark.parametrize(("engine", "package"), [("warp", "warp"), ("compiled", "llvmlite")])
def test_a_job_says_which_package_nobody_has(engine: str, package: str, stack: Stack) -> None:
    announce(stack, "cpu", packages=("dm_control",))
    spec = {"kind": "train", "environment": "ant", "physics": engine}
    job = stack.http.post("/jobs", json=spec).json()["id"]
    told = stack.http.get(f"/jobs/{job}").json()["waiting_for"]
    assert told.startswith(f"No suitable worker can run the engine {engine} (uv sync --inexact --extra")
    announce(stack, "cpu", packages=("dm_control", package))
    assert stack.http.get(f"/jobs/{job}").json()["waiting_for"] is None


def test_a_job_that_was_cancelled_waits_for_nobody(stack: Stack) -> None:
    job = submit(stack, gpus=1)
    stack.http.post(f"/jobs/{job}/cancel")
    assert stack.http.get(f"/jobs/{job}").json()["waiting_for"] is None


def announce(stack: Stack, device: str, packages: tuple[str, ...] | None = None) -> None:
    info = WorkerInfo(
        name=device,
        host="host",
        pid=1,
        device=device,
        queues=queue_names(device),
        packages=packages,
        started_at=NOON,
        seen_at=NOON,
    )
    stack.store.announce(info, timedelta(seconds=40))


def submit(stack: Stack, gpus: int) -> str:
    spec = {"kind": "train", "environment": "ant", "resources": {"gpus": gpus}}
    return stack.http.post("/jobs", json=spec).json()["id"]


def test_a_job_says_how_many_are_before_it(stack: Stack) -> None:
    announce(stack, "cpu")
    first, second = (stack.http.post("/jobs", json=_ANT).json()["id"] for _ in range(2))
    turn = stack.http.get(f"/jobs/{second}").json()["turn"]
    assert turn["before"] == 1
    assert "1 job has its turn before it" in turn["reason"]
    listed = {item["id"]: item["turn"]["before"] for item in stack.http.get("/jobs").json()["items"]}
    assert listed == {first: 0, second: 1}
    stack.http.post(f"/jobs/{first}/cancel")
    assert stack.http.get(f"/jobs/{first}").json()["turn"] is None


def test_turns_are_those_known_before_while_they_are_looked_up_or_the_record_is_away(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    announce(stack, "cpu")
    stack.http.post("/jobs", json=_ANT)
    turns, workers = Turns(stack.store), stack.store.workers()
    known = turns.now(workers)
    assert len(known) == 1
    meanwhile = list[object]()

    def away() -> NoReturn:
        with ThreadPoolExecutor(1) as pool:
            meanwhile.append(pool.submit(turns.now, workers).result(timeout=5))
        raise RecordsUnavailable("It is away.")

    monkeypatch.setattr(stack.store, "turn_facts", away)
    turns._until = 1.0  # pyright: ignore[reportPrivateUsage] # Long ago.
    assert [turns.now(workers) for _ in range(3)] == [known] * 3
    assert meanwhile == [known]  # Asked once.


def test_a_job_says_which_one_makes_room_for_it_and_that_one_for_whom_it_was(stack: Stack) -> None:
    announce(stack, "cpu")
    low = stack.http.post("/jobs", json={**_ANT, "priority": "low"}).json()["id"]
    job = stack.store.take_turn(queue_names("cpu"), "cpu", lease=timedelta(seconds=30), secret="s")
    assert job is not None
    high = stack.http.post("/jobs", json={**_ANT, "priority": "high"}).json()["id"]
    assert stack.store.make_room() == {high: [low]}
    turn = stack.http.get(f"/jobs/{high}").json()["turn"]
    assert (turn["before"], turn["reason"]) == (0, f"Job {low} makes room for it, and goes on later.")
    assert turn["starts_at"] is not None
    message = f"It made room for job {high}. The work up to then is kept."
    stack.store.save(job.requeued(Reason.PREEMPTED, message, NOON))
    forecast = Turns(stack.store).now(stack.store.workers())[low]
    view = job_view(stack.store.get(low), turns={low: forecast})
    assert view.turn is not None
    assert view.turn.reason.startswith(f"{message} It goes on later. It is for the one worker")
