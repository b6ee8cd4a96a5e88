"""Events, logs and metrics: as they come, resumed where they broke off, ended with the job."""

import json
import math
import threading
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Any

import httpx
import pytest

from api import following
from core.errors import RecordsUnavailable
from core.jobs.status import JobStatus, Reason
from core.jobs.store import Entry
from tests.api.conftest import NOON, Attempt, Stack, job, serving
from tests.api.problems import pointers, problem


def events(answer: httpx.Response) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(id, kind, data) of each server-sent event."""
    fields: dict[str, str] = {}
    for line in answer.iter_lines():
        name, _, value = line.partition(": ")
        if line:
            fields[name] = value
        elif "data" in fields:
            yield fields.get("id", ""), fields["event"], json.loads(fields["data"])["data"]
            fields = {}


@pytest.fixture
def attempt(stack: Stack) -> Attempt:
    return Attempt(stack, job())


def all_events(stack: Stack, job_id: str, **headers: str) -> list[tuple[str, str, dict[str, Any]]]:
    with stack.http.stream("GET", f"/jobs/{job_id}/events", headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        return list(events(answer))


def test_events_come_in_order_and_end_with_the_final_status(stack: Stack, attempt: Attempt) -> None:
    attempt.say("phase", name="compile", seconds=1.5)
    attempt.say("progress", step=10, total=20)
    attempt.end()
    seen = all_events(stack, attempt.id)
    assert [kind for _, kind, _ in seen] == ["status", "status", "phase", "progress", "status"]
    assert [data["status"] for _, kind, data in seen if kind == "status"] == [
        "starting",
        "running",
        "succeeded",
    ]
    assert seen[2][2] == {"name": "compile", "seconds": 1.5}


def test_a_broken_stream_goes_on_after_the_last_event(stack: Stack, attempt: Attempt) -> None:
    attempt.say("phase", name="trace")
    attempt.end()
    whole = all_events(stack, attempt.id)
    for position, (last_id, _, _) in enumerate(whole[:-1]):
        assert all_events(stack, attempt.id, **{"Last-Event-ID": last_id}) == whole[position + 1 :]
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events?after={whole[1][0]}") as answer:
        assert list(events(answer)) == whole[2:]


def test_who_has_seen_the_end_is_told_not_to_come_back(stack: Stack, attempt: Attempt) -> None:
    attempt.end()
    last_id = all_events(stack, attempt.id)[-1][0]
    answer = stack.http.get(f"/jobs/{attempt.id}/events", headers={"Last-Event-ID": last_id})
    assert (answer.status_code, answer.content) == (204, b"")


def test_what_happens_while_one_watches_is_seen(stack: Stack, attempt: Attempt) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        coming = events(answer)
        assert next(coming)[2]["status"] == "starting"
        assert next(coming)[2]["status"] == "running"
        attempt.say("progress", step=1, total=2)
        assert next(coming)[1:] == ("progress", {"step": 1, "total": 2})
        attempt.end()
        assert next(coming)[2]["status"] == "succeeded"
        assert list(coming) == []


def test_many_watchers_keep_no_other_request_waiting(stack: Stack, attempt: Attempt) -> None:
    # More than the 40 threads that requests share.
    with httpx.Client(base_url=stack.http.base_url, limits=httpx.Limits(max_connections=60)) as http:
        opened = [
            http.send(http.build_request("GET", f"/jobs/{attempt.id}/events"), stream=True) for _ in range(50)
        ]
        assert stack.http.get(f"/jobs/{attempt.id}", timeout=5).status_code == 200
        attempt.end()
        assert all(list(events(answer))[-1][2]["status"] == "succeeded" for answer in opened)


def test_silence_is_broken_by_comments(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "HEARTBEAT_S", 0.1)
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        lines = answer.iter_lines()
        assert next(line for line in lines if line.startswith(":")) == ": still here"
        attempt.end()
        assert "event: status" in list(lines)


def test_a_stream_outlives_an_outage_of_the_records(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        coming = events(answer)
        assert [next(coming)[1], next(coming)[1]] == ["status", "status"]
        was_asked, working = threading.Event(), stack.store.feed

        def away(*_: object, **__: object) -> None:
            was_asked.set()
            raise RecordsUnavailable("Redis does not answer.")

        monkeypatch.setattr(stack.store, "feed", away)
        assert was_asked.wait(10)
        monkeypatch.setattr(stack.store, "feed", working)
        attempt.end()
        assert [data["status"] for _, _, data in coming] == ["succeeded"]


def test_a_deleted_job_ends_its_streams(stack: Stack, attempt: Attempt) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        coming = events(answer)
        next(coming), next(coming)
        stack.store.delete(stack.store.get(attempt.id))
        assert list(coming) == []


def test_a_job_restored_without_its_feed_still_tells_its_end(stack: Stack) -> None:
    ended = job().ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "Enough.", NOON)
    stack.store.add(ended)
    assert [(kind, data["status"]) for _, kind, data in all_events(stack, ended.id)] == [
        ("status", "cancelled")
    ]


@pytest.mark.parametrize("last_id", ["x", "-1", "1-0; DROP"])
def test_an_id_that_no_feed_gave_is_refused(stack: Stack, attempt: Attempt, last_id: str) -> None:
    answer = stack.http.get(f"/jobs/{attempt.id}/events", headers={"Last-Event-ID": last_id})
    assert pointers(problem(answer, 422, "invalid-request")) == ["/after"]


def test_numbers_that_are_not_finite_become_null(stack: Stack, attempt: Attempt) -> None:
    attempt.say("metrics", step=1, values={"loss": math.nan, "reward": 2.0})
    attempt.end()
    assert all_events(stack, attempt.id)[2][2]["values"] == {"loss": None, "reward": 2.0}
    assert stack.http.get(f"/jobs/{attempt.id}/metrics").json()["rows"][0]["values"] == {
        "loss": None,
        "reward": 2.0,
    }


def test_streams_end_when_the_service_stops(stack: Stack, attempt: Attempt) -> None:
    from api.app import create_app

    app = create_app(stack.service.settings, store=stack.store, queue=stack.queue, objects=stack.objects)
    with serving(app) as port:
        connection = httpx.Client().__enter__()
        request = connection.build_request("GET", f"http://127.0.0.1:{port}/jobs/{attempt.id}/events")
        answer = connection.send(request, stream=True)
    # `serving` has waited for the server's end: the stream did not hold it up for its whole grace.
    assert [data["status"] for _, _, data in events(answer)] == ["starting", "running"]
    connection.close()


def test_metrics_are_rows_that_can_be_polled(stack: Stack, attempt: Attempt) -> None:
    attempt.say("metrics", step=0, values={"eval/episode_reward": 1.0})
    first = stack.http.get(f"/jobs/{attempt.id}/metrics").json()
    assert first["rows"] == [
        {"step": 0, "time": "2026-11-20T12:00:00Z", "values": {"eval/episode_reward": 1.0}}
    ]
    attempt.say("metrics", step=10, values={"eval/episode_reward": 2.0})
    later = stack.http.get(f"/jobs/{attempt.id}/metrics", params={"after": first["next"]}).json()
    assert [row["step"] for row in later["rows"]] == [10]
    empty = stack.http.get(f"/jobs/{attempt.id}/metrics", params={"after": later["next"]}).json()
    assert empty == {"rows": [], "next": later["next"]}


def test_a_step_measured_again_shows_once_with_its_newer_values(stack: Stack, attempt: Attempt) -> None:
    for value in (1.0, 2.0):
        attempt.say("metrics", step=5, values={"reward": value})
    attempt.say("metrics", step=5, values={"speed": 3.0})
    rows = stack.http.get(f"/jobs/{attempt.id}/metrics").json()["rows"]
    assert [row["values"] for row in rows] == [{"reward": 2.0}, {"speed": 3.0}]


@pytest.mark.parametrize(
    ("accept", "query"),
    [("text/csv", ""), ("text/csv, application/json;q=0.5", ""), ("application/json", "?format=csv")],
)
def test_metrics_come_as_a_table(stack: Stack, attempt: Attempt, accept: str, query: str) -> None:
    attempt.say("metrics", step=0, values={"b": 1.0})
    attempt.say("metrics", step=10, values={"a,x": 0.5, "b": math.nan})
    answer = stack.http.get(f"/jobs/{attempt.id}/metrics{query}", headers={"Accept": accept})
    assert answer.headers["Content-Type"] == "text/csv; charset=utf-8"
    assert answer.text.splitlines() == [
        'step,time,"a,x",b',
        "0,2026-11-20T12:00:00+00:00,,1.0",
        "10,2026-11-20T12:00:00+00:00,0.5,",
    ]


def test_metrics_of_a_restored_job_come_from_its_file(stack: Stack, attempt: Attempt) -> None:
    line = {"step": 3, "time": "2026-11-20T12:00:00+00:00", "values": {"reward": 1.0}}
    attempt.keep(
        "metrics.jsonl", json.dumps(line).encode() + b"\n", role="metrics", media_type="application/jsonl"
    )
    rows = stack.http.get(f"/jobs/{attempt.id}/metrics").json()["rows"]
    assert [(row["step"], row["values"]) for row in rows] == [(3, {"reward": 1.0})]


def test_a_log_is_plain_text_and_whole(stack: Stack, attempt: Attempt) -> None:
    lines = [f"line {i} <b>é" for i in range(1201)]  # more than two pages of the feed
    for line in lines:
        attempt.say("line", "logs", text=line)
    answer = stack.http.get(f"/jobs/{attempt.id}/logs")
    assert answer.text.splitlines() == lines
    assert answer.headers["Content-Type"] == "text/plain; charset=utf-8"
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_a_followed_log_goes_on_until_the_job_ends(stack: Stack, attempt: Attempt) -> None:
    attempt.say("line", "logs", text="first")
    with stack.http.stream("GET", f"/jobs/{attempt.id}/logs?follow=true") as answer:
        lines = answer.iter_lines()
        assert next(lines) == "first"
        attempt.say("line", "logs", text="second")
        assert next(lines) == "second"
        attempt.end()
        assert list(lines) == []


def test_the_log_of_a_restored_job_comes_from_its_file(stack: Stack, attempt: Attempt) -> None:
    attempt.keep("log.txt", b"kept\n", role="log", media_type="text/plain")
    assert stack.http.get(f"/jobs/{attempt.id}/logs").text == "kept\n"


def test_a_watcher_who_leaves_is_forgotten(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = threading.Event()
    follow = following.Follower.pages

    async def watched(self: following.Follower, *, to_the_end: bool) -> AsyncIterator[Sequence[Entry]]:
        try:
            async for page in follow(self, to_the_end=to_the_end):
                yield page
        finally:
            ended.set()

    monkeypatch.setattr(following.Follower, "pages", watched)
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        next(events(answer))
    assert ended.wait(10)
