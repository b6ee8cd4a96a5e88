"""Events, logs and metrics: as they come, resumed where they broke off, ended with the job."""

import json
import math
import queue
import threading
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import anyio
import httpx
import pytest
from sqlalchemy import event
from structlog.testing import capture_logs

from api import streams
from core.jobs import feeds
from core.jobs.feeds import compact
from core.jobs.job import Progress
from core.jobs.status import JobStatus
from core.jobs.store import Channel, Entry
from core.reasons import Reason
from tests.api.conftest import NOON, Attempt, Stack, job, serving
from tests.api.problems import pointers, problem

Event = tuple[str, str, dict[str, Any]]


def events(answer: httpx.Response) -> Iterator[Event]:
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


def all_events(stack: Stack, job_id: str, **headers: str) -> list[Event]:
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


def test_the_progress_of_a_job_says_its_phase_while_an_attempt_holds_it(
    stack: Stack, attempt: Attempt
) -> None:
    progress = Progress(step=10, total=10, phase="drawing")
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
    view = f"/jobs/{attempt.id}"
    assert stack.http.get(view).json()["progress"]["phase"] == "drawing"
    attempt.end()
    ended = stack.http.get(view).json()["progress"]
    assert (ended["step"], ended["phase"]) == (10, None)
    phase = stack.http.get("/openapi.json").json()["components"]["schemas"]["ProgressView"]["properties"][
        "phase"
    ]
    assert phase["anyOf"][0]["enum"] == [
        "preparing", "compiling", "training", "evaluating", "acting", "drawing", "testing"
    ]  # fmt: skip


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
    monkeypatch.setattr(streams, "HEARTBEAT_S", 0.1)
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        lines = answer.iter_lines()
        assert next(line for line in lines if line.startswith(":")) == ": still here"
        attempt.end()
        assert "event: status" in list(lines)


def test_a_stream_outlives_an_outage_of_the_records(stack: Stack, attempt: Attempt) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        coming = events(answer)
        assert [next(coming)[1], next(coming)[1]] == ["status", "status"]
        with stack.away("store") as missed:
            assert missed.wait(10)
            attempt.end()
        assert [data["status"] for _, _, data in coming] == ["succeeded"]


def test_a_stream_outlives_an_outage_of_the_object_store(stack: Stack, attempt: Attempt) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/logs?follow=true") as answer:
        lines = answer.iter_lines()
        attempt.print("first")
        assert next(lines) == "first"
        with stack.away("objects") as objects_missed:
            with stack.away("store") as missed:  # Until the rest is there, and lies in a chunk.
                assert missed.wait(10)
                attempt.print("second")
                attempt.end()
                compact(store=stack.store, objects=stack.objects)
            assert objects_missed.wait(10)
        assert list(lines) == ["second"]


def test_a_deleted_job_ends_its_streams(stack: Stack, attempt: Attempt) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        coming = events(answer)
        next(coming), next(coming)
        stack.store.delete(attempt.id, stack.store.get(attempt.id).version)
        assert list(coming) == []


def test_a_job_that_was_imported_without_a_feed_still_tells_its_end(stack: Stack) -> None:
    ended = job().ended(JobStatus.CANCELLED, Reason.USER_CANCELLED, "Enough.", NOON)
    stack.store.add(ended)
    assert [(kind, data["status"]) for _, kind, data in all_events(stack, ended.id)] == [
        ("status", "cancelled")
    ]


@pytest.mark.parametrize("last_id", ["x", "-1", "1-0; DROP", "1700000000000-0", "٣", "9" * 30])
def test_an_id_that_no_feed_gave_is_refused(stack: Stack, attempt: Attempt, last_id: str) -> None:
    here = f"/jobs/{attempt.id}/events"
    for asked in ({"params": {"after": last_id}}, {"headers": {"Last-Event-ID": last_id.encode()}}):
        assert pointers(problem(stack.http.get(here, **asked), 422, "invalid-request")) == ["/after"]


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


def test_a_table_has_every_row_of_a_long_job(stack: Stack, attempt: Attempt) -> None:
    # More than one answer has as JSON; the last rows bring a column, which the first line has to name.
    attempt.say_all("metrics", [{"step": step, "values": {"a": 1.0}} for step in range(10_001)])
    attempt.say("metrics", step=10_001, values={"b": 2.0})
    here = f"/jobs/{attempt.id}/metrics"
    assert len(stack.http.get(here).json()["rows"]) == 10_000
    answer = stack.http.get(here, params={"format": "csv"})
    first, *rows = answer.text.splitlines()
    assert first == "step,time,a,b"
    assert [int(row.split(",")[0]) for row in rows] == list(range(10_002))
    assert "Link" not in answer.headers


def test_a_table_is_cut_where_that_is_asked_for_and_says_where_to_continue(
    stack: Stack, attempt: Attempt
) -> None:
    for step in range(5):
        attempt.say("progress", step=step, total=5)
        attempt.say("metrics", step=step, values={"reward": 1.0})
    steps, address = list[int](), f"/jobs/{attempt.id}/metrics?format=csv&limit=2"
    for num_rows in (2, 2, 1):
        answer = stack.http.get(address)
        rows = answer.text.splitlines()[1:]
        assert len(rows) == num_rows
        steps += [int(row.split(",")[0]) for row in rows]
        address = answer.links.get("next", {}).get("url", "")
    assert (steps, address) == ([0, 1, 2, 3, 4], "")


def test_a_table_shows_a_step_measured_again_once(stack: Stack, attempt: Attempt) -> None:
    # A second attempt begins again after step 1, and never measures step 3.
    for step, value in [(1, 0.1), (2, 0.2), (3, 0.3), (2, 1.2), (4, 1.4)]:
        attempt.say("metrics", step=step, values={"reward": value})
    attempt.say("metrics", step=2, values={"speed": 3.0})
    rows = stack.http.get(f"/jobs/{attempt.id}/metrics?format=csv").text.splitlines()
    time = "2026-11-20T12:00:00+00:00"
    assert rows == [
        "step,time,reward,speed",
        f"1,{time},0.1,",
        f"3,{time},0.3,",
        f"2,{time},1.2,",
        f"4,{time},1.4,",
        f"2,{time},,3.0",
    ]


def test_a_log_is_plain_text_and_whole(stack: Stack, attempt: Attempt) -> None:
    lines = [f"line {i} <b>é" for i in range(1201)]  # more than two pages of the feed
    attempt.print(*lines)
    answer = stack.http.get(f"/jobs/{attempt.id}/logs")
    assert answer.text.splitlines() == lines
    assert answer.headers["Content-Type"] == "text/plain; charset=utf-8"
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_a_followed_log_goes_on_until_the_job_ends(stack: Stack, attempt: Attempt) -> None:
    attempt.print("first")
    with stack.http.stream("GET", f"/jobs/{attempt.id}/logs?follow=true") as answer:
        lines = answer.iter_lines()
        assert next(lines) == "first"
        attempt.print("second")
        assert next(lines) == "second"
        attempt.end()
        assert list(lines) == []


def test_a_watcher_who_leaves_is_forgotten(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = threading.Event()
    follow = streams.Follower.coming

    async def watched(self: streams.Follower) -> AsyncIterator[Sequence[Entry]]:
        try:
            async for page in follow(self):
                yield page
        finally:
            ended.set()

    monkeypatch.setattr(streams.Follower, "coming", watched)
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        next(events(answer))
        assert stack.service.watcher.is_looking
    assert ended.wait(10)
    # The fixture `stack` waits until nobody looks any more.


def test_followers_look_for_themselves_where_the_watcher_breaks(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    def defect(_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(stack.store, "marks", defect)
    with stack.http.stream("GET", f"/jobs/{attempt.id}/events") as answer:
        coming = events(answer)
        assert [next(coming)[1], next(coming)[1]] == ["status", "status"]
        attempt.say("phase", name="trace")
        assert next(coming)[1] == "phase"
        attempt.end()
        assert [data["status"] for _, _, data in coming] == ["succeeded"]


NUM_ROWS = 60


@pytest.fixture
def chunked(stack: Stack, attempt: Attempt, due_at_once: None) -> str:
    """The id of a running job with measurements and lines in six chunks each, and some that lie in none."""
    for start in range(0, NUM_ROWS, 9):  # 9 rows, 6 times; and 6 rows in the record.
        rows = range(start, min(start + 9, NUM_ROWS))
        for step in rows:
            attempt.say("metrics", step=step, values={"reward": step / 2})
        attempt.print(*(f"line {step}" for step in rows))
        if len(rows) == 9:
            compact(store=stack.store, objects=stack.objects)
    for channel in ("events", "logs"):
        part = stack.store.feed(attempt.id, channel)
        assert len(part.chunks) == 4, "a reader gets a few at a time"
    return attempt.id


@pytest.fixture
def due_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every entry becomes part of a chunk when it is looked at."""
    monkeypatch.setattr(feeds, "MAX_BYTES", 0)
    monkeypatch.setattr(feeds, "MAX_METRICS_BYTES", 1)


def test_events_are_read_across_chunks_without_gap_or_double(
    stack: Stack, attempt: Attempt, chunked: str
) -> None:
    attempt.end()
    whole = all_events(stack, chunked)
    # Starting, running, the rows, succeeded.
    assert [number for number, _, _ in whole] == [str(number) for number in range(1, NUM_ROWS + 4)]
    assert [data["step"] for _, kind, data in whole if kind == "metrics"] == list(range(NUM_ROWS))
    # The first chunk ends with 11, the second with 20: at their borders, and within them.
    for seen in (1, 5, 11, 12, 19, 20, 21, 47, 56, 57, 60):
        assert all_events(stack, chunked, **{"Last-Event-ID": str(seen)}) == whole[seen:]
    last = stack.http.get(f"/jobs/{chunked}/events", headers={"Last-Event-ID": whole[-1][0]})
    assert last.status_code == 204


def test_metrics_are_read_across_chunks_without_gap_or_double(stack: Stack, chunked: str) -> None:
    here = f"/jobs/{chunked}/metrics"
    whole = stack.http.get(here).json()
    assert [row["step"] for row in whole["rows"]] == list(range(NUM_ROWS))
    table = stack.http.get(here, params={"format": "csv"}).text.splitlines()
    assert [int(row.split(",")[0]) for row in table[1:]] == list(range(NUM_ROWS))
    for limit in (1, 7, 9, 50):
        steps, after = list[int](), ""
        while rows := (page := stack.http.get(here, params={"after": after, "limit": limit}).json())["rows"]:
            assert len(rows) <= limit
            steps += [row["step"] for row in rows]
            after = page["next"]
        assert steps == list(range(NUM_ROWS))


def test_a_log_is_read_across_chunks_without_gap_or_double(
    stack: Stack, attempt: Attempt, chunked: str
) -> None:
    lines = [f"line {step}" for step in range(NUM_ROWS)]
    assert stack.http.get(f"/jobs/{chunked}/logs").text.splitlines() == lines
    attempt.end()
    assert stack.http.get(f"/jobs/{chunked}/logs?follow=true").text.splitlines() == lines


def test_entries_that_become_a_chunk_while_one_watches_are_seen_once(
    stack: Stack, attempt: Attempt, due_at_once: None
) -> None:
    with stack.http.stream("GET", f"/jobs/{attempt.id}/logs?follow=true") as answer:
        coming, seen = answer.iter_lines(), list[str]()
        for number in range(10):
            attempt.print(f"{number}a", f"{number}b")
            if number % 3:  # With the stream somewhere within it, or not yet at it.
                compact(store=stack.store, objects=stack.objects)
            if number % 2:
                seen += [next(coming), next(coming)]
        attempt.end()
        compact(store=stack.store, objects=stack.objects)
        seen += coming
    assert seen == [f"{number}{half}" for number in range(10) for half in "ab"]


def test_a_feed_whose_chunks_cannot_be_read_is_refused_before_its_stream_begins(
    stack: Stack, chunked: str
) -> None:
    with stack.away("objects"):
        for part in ("events", "logs", "logs?follow=true", "metrics", "metrics?format=csv"):
            problem(stack.http.get(f"/jobs/{chunked}/{part}"), 503, "storage-unavailable")


@contextmanager
def followers(stack: Stack, job_id: str, number: int) -> Iterator[list[Iterator[Event]]]:
    """As many streams of the job's events, each of which has brought the first two."""
    with ExitStack() as opened:
        limits = httpx.Limits(max_connections=number)
        http = opened.enter_context(
            httpx.Client(base_url=stack.http.base_url, limits=limits, timeout=60, verify=False)  # noqa: S501
        )
        request = http.build_request("GET", f"/jobs/{job_id}/events")
        answers = [http.send(request, stream=True) for _ in range(number)]
        for answer in answers:
            opened.callback(answer.close)
        streams = [events(answer) for answer in answers]
        for stream in streams:
            assert [next(stream)[0], next(stream)[0]] == ["1", "2"]
        yield streams


def test_each_of_two_hundred_followers_gets_every_entry_once(
    stack: Stack, attempt: Attempt, due_at_once: None
) -> None:
    with followers(stack, attempt.id, 200) as streams:
        for step in range(20):
            attempt.say("progress", step=step, total=20)
            if step % 5 == 4:
                compact(store=stack.store, objects=stack.objects)
        attempt.end()
        for stream in streams:
            assert [number for number, _, _ in stream] == [str(number) for number in range(3, 24)]


@pytest.mark.parametrize("number", [1, 200])
def test_idle_followers_cost_one_query_together(stack: Stack, attempt: Attempt, number: int) -> None:
    seen: queue.SimpleQueue[str] = queue.SimpleQueue()
    other = Attempt(stack, job("019aa3c2f0b2-5be0c1d2e3"))
    with followers(stack, attempt.id, number), followers(stack, other.id, 1):
        engine = stack.store._engine
        event.listen(engine, "before_cursor_execute", lambda *said: seen.put(said[2]))
        looks = 0
        while looks < 5:  # Until the last of the followers has found that there is nothing more.
            looks = looks + 1 if is_look(seen.get(timeout=10)) else 0
        began = time.monotonic()
        while looks < 35:
            statement = seen.get(timeout=10)
            assert is_look(statement), statement
            looks += 1
        # 30 looks, each at both jobs, with 0.1 s between two; the first may have been late.
        assert time.monotonic() - began > 2.5


def test_followers_who_wait_for_the_same_entry_read_it_together(
    stack: Stack, attempt: Attempt, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads: queue.SimpleQueue[int] = queue.SimpleQueue()
    read_page = feeds.read_page

    def counted(job_id: str, channel: Channel, after: int, limit: int, **stores: Any) -> feeds.FeedPage:
        reads.put(after)
        return read_page(job_id, channel, after, limit, **stores)

    monkeypatch.setattr(feeds, "read_page", counted)
    with followers(stack, attempt.id, 100) as streams:
        began = reads.qsize()
        for step in range(5):
            attempt.say("progress", step=step, total=20)
            assert {next(stream)[0] for stream in streams} == {str(3 + step)}
        # By itself each would read each of the 5.
        assert reads.qsize() - began < 25


def is_look(statement: str) -> bool:
    """Whether it is the one that asks how far jobs have come."""
    return statement.startswith("SELECT jobs.id, jobs.version, jobs.num_events, jobs.num_logs")


def test_an_outage_between_two_pages_is_waited_out_and_not_hammered(
    stack: Stack, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streams, "_PAGE", 2)
    attempt = Attempt(stack, job())
    attempt.print("a", "b", "c")
    follower = streams.Follower(stack.service, stack.store.get(attempt.id), "logs", 0)

    async def follow() -> int:
        coming = follower.coming()
        assert [entry.data["text"] for entry in await anext(coming)] == ["a", "b"]
        with stack.away("store"), capture_logs() as said:
            with anyio.move_on_after(0.5):
                await anext(coming)
        return [line["event"] for line in said].count("feed_unavailable")

    # One, and another where the watcher's first look, which wakes every reader, was still to come.
    assert anyio.run(follow) in (1, 2)


def test_events_of_some_kinds_come_with_the_end_and_without_waiting_for_it(
    stack: Stack, attempt: Attempt
) -> None:
    attempt.say("phase", name="compile", seconds=2.0)
    attempt.say("metrics", step=0, values={"reward": 1.0})
    here = f"/jobs/{attempt.id}/events"
    asked = {"kind": ["phase", "note"], "follow": "false"}
    with stack.http.stream("GET", here, params=asked) as answer:
        found = [event.split("\n")[1] for event in answer.read().decode().split("\n\n") if "event:" in event]
    assert found == ["event: phase"]
    attempt.end()
    with stack.http.stream("GET", here, params={"kind": "phase"}) as answer:
        found = [event.split("\n")[1] for event in answer.read().decode().split("\n\n") if "event:" in event]
    assert found == ["event: phase", "event: status"]
    assert pointers(problem(stack.http.get(here, params={"kind": "phases"}), 422, "invalid-request")) == [
        "/kind"
    ]
