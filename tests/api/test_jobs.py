"""Submitting, reading, listing, cancelling and deleting jobs."""

import re
from datetime import timedelta
from typing import Any, Literal

import httpx
import pytest
from sqlalchemy import text

from core.jobs.job import utc_now
from core.jobs.reconciliation import Reconciler
from core.jobs.status import JobStatus
from core.jobs.store import JobQuery
from core.reasons import Reason
from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import pointers, problem

MINIMAL = {"kind": "train", "environment": "ant"}


def ids(answer: httpx.Response) -> list[str]:
    assert answer.status_code == 200, answer.text
    return [item["id"] for item in answer.json()["items"]]


def test_a_submission_is_stored_queued_and_answered_with_its_address(stack: Stack) -> None:
    answer = stack.http.post("/jobs", json=MINIMAL)
    view = answer.json()
    assert answer.status_code == 202
    assert answer.headers["Location"] == f"/jobs/{view['id']}" == view["links"]["self"]
    assert stack.store.get(view["id"]).status == JobStatus.QUEUED
    assert [(d.job_id, d.attempt) for d in stack.queue.waiting()] == [(view["id"], 1)]
    stack.service.acknowledgements.flush()
    assert stack.store.undispatched() == []
    assert list(stack.objects.list("")) == []


def test_a_job_reads_as_it_was_sent_with_times_in_utc(stack: Stack) -> None:
    sent = MINIMAL | {"name": "first steps", "labels": {"project": "gaits"}, "seed": 7}
    view = stack.http.get(stack.http.post("/jobs", json=sent).headers["Location"]).json()
    assert view["spec"] == sent | {"environment": {"id": "ant"}}
    assert (view["kind"], view["name"], view["labels"]) == ("train", "first steps", {"project": "gaits"})
    assert (view["status"], view["reason"], view["attempts"], view["artifacts"]) == ("queued", None, [], [])
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z", view["created_at"])


def star(algorithm: dict[str, Any], **options: Any) -> dict[str, Any]:
    environment = {"id": "brittle_star", "options": options} if options else {"id": "brittle_star"}
    return {"kind": "train", "environment": environment, "algorithm": algorithm}


def test_a_star_in_one_line_takes_what_its_table_is_tuned_for(stack: Stack) -> None:
    sent = star({"kind": "q_learning", "num_episodes": 8})
    answer = stack.http.post("/jobs", json=sent)
    assert answer.status_code == 202
    assert answer.json()["spec"] == star({"kind": "q_learning", "num_episodes": 8}, control="cpg")


@pytest.mark.parametrize(
    "sent",
    [
        star({"kind": "ppo"}),
        star({"kind": "q_learning"}, control="cpg", num_arms=4),
        # Who says how the star is to act says the rest, too.
        star(
            {
                "kind": "q_learning",
                "state_discretizer": {"kind": "arm_role"},
                "action_set": {"kind": "arm_actions", "actions": [[0.0] * 10, [1.0] * 10]},
            }
        ),
    ],
)
def test_nothing_is_taken_where_nothing_is_needed(stack: Stack, sent: dict[str, Any]) -> None:
    answer = stack.http.post("/jobs", json=sent)
    assert (answer.status_code, answer.json()["spec"]) == (202, sent)


@pytest.mark.parametrize("part", ["queue", "objects"])
def test_a_submission_needs_nothing_but_the_record(stack: Stack, part: Literal["queue", "objects"]) -> None:
    with stack.away(part):
        answer = stack.http.post("/jobs", json=MINIMAL)
    assert (answer.status_code, answer.json()["status"]) == (202, "queued")
    assert stack.store.get(answer.json()["id"]).status == JobStatus.QUEUED
    # What the queue was not told, the reconciler tells it.
    Reconciler(stack.store, stack.queue, timedelta(seconds=15)).run_once()
    assert [(d.job_id, d.attempt) for d in stack.queue.waiting()] == [(answer.json()["id"], 1)]


def test_a_submission_while_the_record_is_away_may_be_repeated(stack: Stack) -> None:
    with stack.away("store"):
        answer = stack.http.post("/jobs", json=MINIMAL)
    problem(answer, 503, "records-unavailable")
    assert answer.headers["Retry-After"] == "7"
    assert stack.is_empty()


def test_text_that_no_job_is_found_by_may_hold_any_character(stack: Stack) -> None:
    sent = MINIMAL | {"tracking": {"wandb": {"project": "vnl", "name": "null \0, \U0001f98e"}}}
    view = stack.http.get(stack.http.post("/jobs", json=sent).headers["Location"]).json()
    assert view["spec"]["tracking"] == sent["tracking"]


def test_an_attempt_is_shown_without_its_lease_token(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    answer = stack.http.get(f"/jobs/{attempt.id}")
    shown = answer.json()["attempts"][0]
    assert (shown["worker"], shown["device"], shown["engine"]) == ("worker-1", "cpu", "native")
    assert attempt.claim.token not in answer.text
    assert "token" not in shown


def test_the_same_idempotency_key_and_body_make_one_job(stack: Stack) -> None:
    headers = {"Idempotency-Key": "once"}
    first = stack.http.post("/jobs", json=MINIMAL, headers=headers)
    # The same meaning in another spelling.
    again = stack.http.post(
        "/jobs",
        content=b' {"environment": {"id": "ant"}, "kind": "train"}',
        headers={**headers, "Content-Type": "application/json; charset=utf-8"},
    )
    assert again.status_code == 202
    assert again.json()["id"] == first.json()["id"]
    assert len(stack.queue.waiting()) == 1


def test_an_idempotency_key_with_another_body_is_refused(stack: Stack) -> None:
    headers = {"Idempotency-Key": "once"}
    stack.http.post("/jobs", json=MINIMAL, headers=headers)
    answer = stack.http.post("/jobs", json=MINIMAL | {"seed": 1}, headers=headers)
    assert "'once'" in problem(answer, 409, "idempotency-key-reused")["detail"]
    assert len(stack.queue.waiting()) == len(stack.store.list(JobQuery()).jobs) == 1


def test_a_listing_goes_page_by_page_from_the_newest(stack: Stack) -> None:
    made = [f"019aa3c2f0b{i}-5be0c1d2e3" for i in range(5)]
    for job_id in made:
        stack.store.add(job(job_id))
    seen, cursor = list[str](), None
    while True:
        page = stack.http.get("/jobs", params={"limit": 2} | ({"cursor": cursor} if cursor else {}))
        seen += ids(page)
        cursor = page.json()["next"]
        if cursor is None:
            break
    assert seen == made[::-1]


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ("", "ba"),
        ("status=queued", "ba"),
        ("status=failed", ""),
        ("kind=rollout", ""),
        ("environment=ant", "ba"),
        ("environment=hopper", ""),
        ("name=b", "b"),
        ("search=B", "b"),
        ("search=AN", "ba"),
        ("search=", "ba"),
        ("label=group:x", "ba"),
        ("label=group:x&label=seed:2", "b"),
        ("label=group%3Dx&label=seed%3D1", "a"),
        ("label=url:http://a:b", "a"),
    ],
)
def test_filters_narrow_a_listing(stack: Stack, query: str, found: str) -> None:
    a = job("00000000000a-0000000000", name="a", labels={"group": "x", "seed": "1", "url": "http://a:b"})
    b = job("00000000000b-0000000000", name="b", labels={"group": "x", "seed": "2"})
    stack.store.add(a)
    stack.store.add(b)
    assert [job_id[11] for job_id in ids(stack.http.get(f"/jobs?{query}"))] == list(found)


@pytest.mark.parametrize(
    ("query", "pointer"),
    [
        ("limit=0", "/limit"),
        ("limit=201", "/limit"),
        ("limit=" + "9" * 5000, "/limit"),
        ("limit=x", "/limit"),
        ("status=asleep", "/status"),
        ("statsu=queued", "/statsu"),
        ("cursor=../..", "/cursor"),
        ("label=nothing", "/label"),
        ("label=a:%00", "/label"),
        ("name=%00", "/name"),
        ("environment=%00", "/environment"),
        ("cursor=%00", "/cursor"),
    ],
)
def test_a_wrong_filter_is_refused_and_not_passed_over(stack: Stack, query: str, pointer: str) -> None:
    assert pointer in pointers(problem(stack.http.get(f"/jobs?{query}"), 422, "invalid-request"))


def test_a_waiting_job_is_cancelled_at_once_and_twice_is_the_same(stack: Stack) -> None:
    location = stack.http.post("/jobs", json=MINIMAL).headers["Location"]
    for _ in range(2):
        answer = stack.http.post(f"{location}/cancel")
        assert (answer.status_code, answer.json()["status"]) == (200, "cancelled")
        assert answer.json()["reason"] == "user_cancelled"
    assert stack.queue.waiting() == []


def test_a_running_job_is_asked_to_stop(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    answer = stack.http.post(f"/jobs/{attempt.id}/cancel")
    assert (answer.status_code, answer.json()["status"]) == (202, "cancelling")


def test_cancelling_what_has_ended_is_a_conflict(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.end()
    answer = stack.http.post(f"/jobs/{attempt.id}/cancel")
    assert "already succeeded" in problem(answer, 409, "job-finished")["detail"]


def test_a_job_may_end_with_words_that_no_database_stores(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.claim.end(JobStatus.FAILED, Reason.TRAINING_CRASHED, "It last said: \0\0.")
    view = stack.http.get(f"/jobs/{attempt.id}").json()
    assert (view["message"], view["attempts"][0]["message"]) == ("It last said: \ufffd\ufffd.",) * 2


@pytest.fixture
def unreadable(stack: Stack) -> Attempt:
    """A running job whose specification another version wrote; and a job before and after it."""
    attempt = Attempt(stack, job("00000000000b-0000000000", name="b", labels={"group": "x"}))
    damage(stack, attempt.id, '{"kind": "train", "environment": {"id": "ant"}, "algorithm": {"kind": "td3"}}')
    for other in ("a", "c"):
        stack.store.add(job(f"00000000000{other}-0000000000", name=other))
    return attempt


def damage(stack: Stack, job_id: str, spec: str) -> None:
    with stack.store._engine.begin() as connection:
        connection.execute(text("UPDATE jobs SET spec = :spec WHERE id = :id"), {"spec": spec, "id": job_id})


def test_a_record_that_cannot_be_read_is_listed_among_the_others(stack: Stack, unreadable: Attempt) -> None:
    items = stack.http.get("/jobs").json()["items"]
    assert [(item["name"], item["status"], item["reason"]) for item in items] == [
        ("c", "queued", None),
        ("b", "running", "unreadable"),
        ("a", "queued", None),
    ]
    assert stack.http.get("/jobs?label=group:x").json()["items"] == [items[1]]
    assert stack.http.get(f"/jobs/{unreadable.id}").json() == items[1]


def test_a_record_that_cannot_be_read_shows_what_can(stack: Stack, unreadable: Attempt) -> None:
    unreadable.say("phase", name="trace")
    unreadable.print("a line")
    view = stack.http.get(f"/jobs/{unreadable.id}").json()
    assert view["message"].startswith("This version of Gaitway cannot read the job's record (")
    assert "algorithm" in view["message"]
    assert view["spec"]["algorithm"] == {"kind": "td3"}
    assert (view["kind"], view["labels"], view["attempts"], view["artifacts"]) == (
        "train",
        {"group": "x"},
        [],
        [],
    )
    assert stack.http.get(f"/jobs/{unreadable.id}/logs").text == "a line\n"
    assert stack.http.get(f"/jobs/{unreadable.id}/metrics").json()["rows"] == []
    damage(stack, unreadable.id, "no JSON at all")
    assert stack.http.get(f"/jobs/{unreadable.id}").json()["spec"] == {}


def test_a_status_of_another_version_is_shown_as_not_ended(stack: Stack, unreadable: Attempt) -> None:
    with stack.store._engine.begin() as connection:
        connection.execute(text("UPDATE jobs SET status = 'paused' WHERE name = 'c'"))
    first, *others = stack.http.get("/jobs").json()["items"]
    assert (first["name"], first["status"], first["reason"]) == ("c", "running", "unreadable")
    assert "status" in first["message"]
    assert [item["name"] for item in others] == ["b", "a"]
    problem(stack.http.delete(f"/jobs/{first['id']}"), 409, "job-not-finished")


@pytest.mark.parametrize(
    "part", ["cancel", "video", "artifacts", "checkpoints", "checkpoints/1", "artifacts/x"]
)
def test_what_needs_the_whole_record_is_a_conflict_where_it_cannot_be_read(
    stack: Stack, unreadable: Attempt, part: str
) -> None:
    answer = stack.http.request("POST" if part == "cancel" else "GET", f"/jobs/{unreadable.id}/{part}")
    assert unreadable.id in problem(answer, 409, "job-unreadable")["detail"]


def test_a_job_whose_record_cannot_be_read_can_be_deleted_once_it_has_ended(
    stack: Stack, unreadable: Attempt
) -> None:
    problem(stack.http.delete(f"/jobs/{unreadable.id}"), 409, "job-not-finished")
    with stack.store._engine.begin() as connection:
        connection.execute(text("UPDATE jobs SET status = 'failed' WHERE name = 'b'"))
    events = stack.http.get(f"/jobs/{unreadable.id}/events").text
    assert '"reason":"unreadable"' in events
    assert stack.http.delete(f"/jobs/{unreadable.id}").status_code == 204
    problem(stack.http.get(f"/jobs/{unreadable.id}"), 404, "job-not-found")
    assert [item["name"] for item in stack.http.get("/jobs").json()["items"]] == ["c", "a"]


def test_a_job_does_not_begin_from_one_whose_record_cannot_be_read(stack: Stack, unreadable: Attempt) -> None:
    for sent, pointer in (
        ({"kind": "train", "resume_from": {"job": unreadable.id}}, "/resume_from/job"),
        ({"kind": "rollout", "policy": {"kind": "checkpoint", "job": unreadable.id}}, "/policy/job"),
    ):
        answer = stack.http.post("/jobs", json={"environment": "ant", **sent})
        assert pointers(problem(answer, 422, "invalid-request")) == [pointer]


def test_only_what_has_ended_can_be_deleted(stack: Stack) -> None:
    attempt = Attempt(stack, job())
    attempt.keep("video.mp4")
    problem(stack.http.delete(f"/jobs/{attempt.id}"), 409, "job-not-finished")
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    answer = stack.http.delete(f"/jobs/{attempt.id}")
    assert (answer.status_code, answer.content) == (204, b"")
    problem(stack.http.get(f"/jobs/{attempt.id}"), 404, "job-not-found")
    assert list(stack.objects.list("")) == []


@pytest.mark.parametrize(
    "part", ["", "/cancel", "/events", "/metrics", "/logs", "/video", "/artifacts", "/checkpoints/1"]
)
@pytest.mark.parametrize(
    "job_id", ["nope", "%00", "..%00", "019AA3C2F0B1-5BE0C1D2E3", "019aa3c2f0b1-5be0c1d2e3", "x" * 5000]
)
def test_an_id_that_names_no_job_is_not_found(stack: Stack, job_id: str, part: str) -> None:
    method = "POST" if part == "/cancel" else "GET"
    problem(stack.http.request(method, f"/jobs/{job_id}{part}"), 404, "job-not-found")


def test_ids_with_slashes_or_dots_are_no_address(stack: Stack) -> None:
    for path in ("/jobs/a/b", "/jobs/%2e%2e/%2e%2e/etc", "/jobs/..%2fsecret", "/jobs/", "//", "/nothing"):
        # Not joined by the client, which would tidy the dots away.
        answer = stack.http.get(
            httpx.URL(scheme="http", host="127.0.0.1", port=stack.port, raw_path=path.encode())
        )
        assert answer.status_code == 404, path
        assert answer.headers["content-type"] == "application/problem+json"


def test_another_method_is_refused_with_those_there_are(stack: Stack) -> None:
    answer = stack.http.put("/healthz")
    problem(answer, 405, "method-not-allowed")
    assert answer.headers["Allow"] == "GET"
    assert stack.http.put("/jobs").headers["Allow"] == "GET, POST"
    assert stack.http.put(f"/jobs/{job().id}").headers["Allow"] == "DELETE, GET, PATCH"


def test_a_lone_submission_takes_little_time(stack: Stack) -> None:
    started = utc_now()
    for _ in range(50):
        assert stack.http.post("/jobs", json=MINIMAL).status_code == 202
    assert (utc_now() - started).total_seconds() / 50 < 0.1  # ~6 ms here; a loaded machine gets patience.


def test_who_takes_a_list_that_is_not_quite_new_may_get_another_readers(stack: Stack) -> None:
    def seen(age: str) -> int:
        return len(ids(stack.http.get("/jobs", headers={"Cache-Control": age})))

    stack.http.post("/jobs", json=MINIMAL)
    assert seen("") == 1
    stack.store.add(job())
    assert seen("max-age=100") == 1
    assert seen("max-age=0") == 2
    assert seen("no-cache") == 2
    assert seen("max-age=100") == 2
    # Another question has no answer yet.
    assert len(ids(stack.http.get("/jobs?kind=train", headers={"Cache-Control": "max-age=100"}))) == 2
