"""A job that cannot fit on any worker there is, is refused when it is sent."""

from datetime import timedelta
from typing import Any

import pytest

from core.jobs.queue import queue_names
from core.jobs.workers import WorkerInfo
from tests.api.conftest import NOON, Stack
from tests.api.problems import pointers, problem

# 1024 * 1024 * 100 transitions of 39 floats: 15.2 GiB.
_LARGE = {
    "kind": "train",
    "environment": "ant",
    "algorithm": {"num_envs": 1024, "batch_size": 1024, "num_minibatches": 1024, "unroll_length": 100},
}


def announce(stack: Stack, device: str, gib: float | None) -> None:
    info = WorkerInfo(
        name=f"w{gib}",
        host="h",
        pid=1,
        device=device,
        queues=queue_names(device),
        memory_bytes=None if gib is None else int(gib * 2**30),
        started_at=NOON,
        seen_at=NOON,
    )
    stack.store.announce(info, timedelta(minutes=1))


def test_it_is_told_what_it_needs_what_there_is_and_what_to_lower(stack: Stack) -> None:
    announce(stack, "cpu", 8)
    announce(stack, "gpu:0", 15)
    document = problem(stack.http.post("/jobs", json=_LARGE), 422, "invalid-request")
    assert "needs at least 15.2 GiB of memory" in document["detail"]
    assert "the largest GPU of a worker has 15 GiB: lower batch_size" in document["detail"]
    assert pointers(document) == [
        f"/algorithm/{name}" for name in ("batch_size", "num_minibatches", "unroll_length")
    ]
    assert stack.is_empty()


def test_each_of_several_seeds_needs_as_much(stack: Stack) -> None:
    announce(stack, "cpu", 46)
    assert stack.http.post("/jobs", json=_LARGE | {"seeds": [0, 1, 2]}).status_code == 202
    document = problem(
        stack.http.post("/jobs", json=_LARGE | {"seeds": [0, 1, 2, 3]}), 422, "invalid-request"
    )
    assert "needs at least 60.9 GiB of memory" in document["detail"]
    assert "unroll_length or the number of seeds" in document["detail"]
    assert pointers(document)[-1] == "/seeds"


@pytest.mark.parametrize(
    ("workers", "wanted"),
    [
        ([], {}),  # Whoever comes may be large enough, and looks by itself.
        ([("cpu", 8.0), ("gpu:0", 16.0)], {}),
        ([("cpu", 8.0), ("gpu:0", None)], {}),
        ([("cpu", 16.0), ("gpu:0", 8.0)], {"accelerator": "cpu"}),
        ([("cpu", 1.0)], {"accelerator": "gpu"}),  # Workers of another kind say nothing of it.
        ([("gpu:0,1", 8.0)], {"gpus": 2}),  # Each of two has half of it.
    ],
)
def test_it_is_accepted_where_it_may_fit(
    stack: Stack, workers: list[tuple[str, float | None]], wanted: dict[str, Any]
) -> None:
    for device, gib in workers:
        announce(stack, device, gib)
    answer = stack.http.post("/jobs", json={**_LARGE, "resources": wanted})
    assert answer.status_code == 202, answer.text
