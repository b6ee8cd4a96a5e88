"""Whatever a request holds, it is refused in time that its size bounds, and beside other requests."""

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.api.conftest import Stack
from tests.api.problems import pointers, problem

_JOB: dict[str, Any] = {"kind": "train", "environment": "ant"}
_WRONG: list[tuple[dict[str, Any], str, str]] = [
    ({"labels": {f"a b{n}": 0 for n in range(50_000)}}, "/labels", "`labels` has 50,000 members"),
    ({f"a{n}": 0 for n in range(50_000)}, "", "members; an object has 64 at most."),
    ({"randomization": [{}] * 5000}, "/randomization", "has 5,000 items; at most 64 are allowed."),
    ({"video": {"cameras": ["a"] * 50_000}}, "/video/cameras", "a list has 10,000 at most."),
    ({"name": "a" * 900_000}, "/name", "`name` has 900,000 characters; at most 200 are allowed."),
]


@pytest.mark.parametrize(("changes", "pointer", "sentence"), _WRONG)
def test_many_wrong_places_are_refused_before_each_is_looked_at(
    stack: Stack, changes: dict[str, Any], pointer: str, sentence: str
) -> None:
    """M5: 110,000 wrong labels took 290 MiB."""
    document = problem(stack.http.post("/jobs", json={**_JOB, **changes}), 422, "invalid-request")
    assert pointers(document) == [pointer]
    assert sentence in document["detail"]


def test_a_large_body_is_parsed_beside_other_requests(stack: Stack) -> None:
    """M5: the event loop parsed it, so that nobody else got an answer."""
    body = {"job": _JOB, "parameters": {f"a{n}": {f"b{k}": 0 for k in range(64)} for n in range(64)}}
    with ThreadPoolExecutor() as pool:
        answers = [pool.submit(stack.http.post, "/sweeps", json=body) for _ in range(24)]
        waits = list[float]()
        while not all(answer.done() for answer in answers):
            before = time.monotonic()
            assert stack.http.get("/healthz").status_code == 200
            waits.append(time.monotonic() - before)
    assert [answer.result().status_code for answer in answers] == [422] * 24
    assert len(waits) > 3  # It was answered meanwhile.
