"""Many jobs at once, and what people call a job and say of it."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from api.routes import bulk
from core.errors import JobNotFound, RecordsUnavailable
from core.jobs.job import Job
from core.jobs.status import JobStatus
from core.jobs.store import JobStore
from core.reasons import Reason
from tests.api.accounts import Lab, opened
from tests.api.conftest import NOON, Attempt, Stack, job
from tests.api.problems import pointers, problem

UNKNOWN = "019aa3c2f0b1-5be0c1d2e3"


@pytest.fixture
def lab(server: tuple[FastAPI, int], stack: Stack) -> Iterator[Lab]:
    with opened(server[0], stack) as lab:
        yield lab


def number(at: int) -> str:
    return f"{at:012x}-0000000000"


def ended(at: int, **facts: Any) -> Job:
    new = job(number(at), **facts.pop("spec", {})).model_copy(update=facts)
    return new.ended(JobStatus.FAILED, Reason.DIVERGED, "NaN.", NOON)


def results(answer: httpx.Response) -> dict[str, str]:
    """The result of each job, or its refusal's code."""
    assert answer.status_code == 200, answer.text
    return {one["job"]: one["code"] or one["result"] for one in answer.json()["items"]}


class TestCancel:
    def test_each_job_is_answered_alone(self, stack: Stack) -> None:
        waiting, running, over = job(number(1)), Attempt(stack, job(number(2))), ended(3)
        for one in (waiting, over):
            stack.store.add(one)
        chosen = {"jobs": [over.id, waiting.id, UNKNOWN, running.id, waiting.id]}
        answer = stack.http.post("/jobs/cancel", json=chosen)
        assert results(answer) == {
            over.id: "job-finished",
            waiting.id: "cancelled",
            UNKNOWN: "job-not-found",
            running.id: "cancelling",
        }
        assert answer.json()["items"][0]["message"] == (
            f"Job {over.id} has already failed; there is nothing to cancel."
        )
        assert stack.queue.waiting() == []
        assert results(stack.http.post("/jobs/cancel", json=chosen)) == results(answer)

    def test_the_queue_may_be_away(self, stack: Stack) -> None:
        ids = [stack.http.post("/jobs", json={"kind": "train", "environment": "ant"}).json()["id"]]
        with stack.away("queue"):
            assert results(stack.http.post("/jobs/cancel", json={"jobs": ids})) == {ids[0]: "cancelled"}

    def test_a_record_that_is_away_refuses_all(self, stack: Stack) -> None:
        with stack.away("store"):
            answer = stack.http.post("/jobs/cancel", json={"jobs": [UNKNOWN]})
        problem(answer, 503, "records-unavailable")


class TestDelete:
    def test_a_filter_deletes_what_it_matches_and_says_what_stays(self, stack: Stack) -> None:
        sweep = {"labels": {"sweep": "3"}}
        for one in (ended(1, spec=sweep), ended(2), job(number(3), **sweep)):
            stack.store.add(one)
        answer = stack.http.post("/jobs/delete", json={"filter": {"label": ["sweep=3"]}})
        assert results(answer) == {number(3): "job-not-finished", number(1): "deleted"}
        assert answer.json()["next"] is None
        left = stack.http.get("/jobs").json()["items"]
        assert [one["id"] for one in left] == [number(3), number(2)]
        assert stack.store.deletions() == [number(1)]

    def test_more_than_200_come_in_parts(self, stack: Stack) -> None:
        for at in range(201):
            stack.store.add(ended(at))
        chosen: dict[str, Any] = {"filter": {"status": "failed"}}
        first = stack.http.post("/jobs/delete", json=chosen)
        assert [*results(first).values()] == ["deleted"] * 200
        rest = stack.http.post("/jobs/delete", json={**chosen, "cursor": first.json()["next"]})
        assert results(rest) == {number(0): "deleted"}

    def test_a_job_whose_checkpoint_is_needed_stays(self, stack: Stack) -> None:
        source = ended(1)
        stack.store.add(source)
        stack.store.add(job(number(2), resume_from={"job": source.id}))
        answer = stack.http.post("/jobs/delete", json={"jobs": [source.id]})
        assert results(answer) == {source.id: "job-in-use"}


@pytest.mark.parametrize("path", ["/jobs/cancel", "/jobs/delete"])
@pytest.mark.parametrize(
    ("sent", "pointer", "word"),
    [
        ({}, "", "either `jobs` or `filter`"),
        ({"jobs": [UNKNOWN], "filter": {"status": "failed"}}, "", "either `jobs` or `filter`"),
        ({"filter": {}}, "", "matches all jobs"),
        ({"filter": {"label": []}}, "", "matches all jobs"),
        ({"jobs": []}, "/jobs", "at least 1"),
        ({"jobs": [UNKNOWN] * 201}, "/jobs", "at most 200"),
        ({"jobs": ["../x"]}, "/jobs/0", "must match"),
        ({"filter": {"state": "failed"}}, "/filter/state", "did you mean `status`"),
        ({"filter": {"status": "lost"}}, "/filter/status", "'queued'"),
        ({"filter": {"label": ["sweep"]}}, "/filter/label", "key:value"),
        ({"jobs": [UNKNOWN], "cursor": UNKNOWN}, "", "goes with a `filter`"),
    ],
)
def test_a_choice_that_is_none_is_refused(
    stack: Stack, path: str, sent: dict[str, Any], pointer: str, word: str
) -> None:
    document = problem(stack.http.post(path, json=sent), 422, "invalid-request")
    assert pointers(document) == [pointer]
    assert word in document["detail"]


def test_jobs_of_others_are_refused_each_and_hidden_ones_are_not_found(lab: Lab) -> None:
    for at, owner, project in ((1, "ann", "a"), (2, "amy", "a"), (3, "bob", "b"), (4, None, "a")):
        lab.stack.store.add(ended(at, owner=owner, project=project))
    ids = [number(at) for at in range(1, 5)]
    answer = lab.of("ann").post("/jobs/delete", json={"jobs": ids})
    assert results(answer) == {
        ids[0]: "deleted",
        ids[1]: "forbidden",
        ids[2]: "job-not-found",
        ids[3]: "forbidden",
    }
    assert "belongs to amy: only its owner or an admin" in answer.json()["items"][1]["message"]
    assert set(results(lab.of("root").post("/jobs/delete", json={"jobs": ids[1:]})).values()) == {"deleted"}
    lab.service.audit_log.flush()
    noted = [(one.user, one.action, one.object) for one in lab.stack.store.audit(action="job.").entries]
    assert sorted(noted) == [
        ("ann", "job.deleted", f"job {ids[0]}"),
        *(("root", "job.deleted", f"job {one}") for one in ids[1:]),
    ]


def test_what_was_done_before_a_bug_is_noted_and_the_queue_knows_it(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent = {"kind": "train", "environment": "ant", "project": "a"}
    first, second = (lab.of("ann").post("/jobs", json=sent).json()["id"] for _ in range(2))
    cancel = bulk.cancel_in_record

    def failing(job_id: str, *, store: JobStore) -> Job:
        if job_id == second:
            raise RuntimeError("A bug.")
        return cancel(job_id, store=store)

    monkeypatch.setattr(bulk, "cancel_in_record", failing)
    answer = lab.of("ann").post("/jobs/cancel", json={"jobs": [first, second]})
    assert answer.status_code == 500
    lab.service.audit_log.flush()
    (entry,) = lab.stack.store.audit(action="job.cancelled").entries
    assert entry.object == f"job {first}"
    assert [dispatch.job_id for dispatch in lab.stack.queue.waiting()] == [second]


def test_an_outage_in_the_middle_and_a_request_that_takes_too_long_leave_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def act(job_id: str) -> str:
        if job_id == "b":
            raise JobNotFound(job_id)
        if job_id == "c":
            raise RecordsUnavailable("PostgreSQL does not answer.")
        return "deleted"

    moments = iter(range(100))
    monkeypatch.setattr(bulk, "monotonic", lambda: next(moments))
    found = bulk.outcomes_of("abcd", act, 1000)
    assert [one.code for one in found] == [
        None,
        "job-not-found",
        "records-unavailable",
        "records-unavailable",
    ]
    with pytest.raises(RecordsUnavailable):
        bulk.outcomes_of("cd", act, 1000)
    # The clock says 4, 5, 6, …
    found = bulk.outcomes_of("aaaa", act, 5)
    assert [one.code for one in found] == [None, *["not-reached"] * 3]


class TestPatch:
    def test_it_merges_and_null_removes(self, stack: Stack) -> None:
        sent = {"kind": "train", "environment": "ant", "name": "a", "labels": {"team": "legs", "draft": "1"}}
        here = stack.http.post("/jobs", json=sent).headers["Location"]
        patch = {"labels": {"draft": None, "knee": "soft"}, "note": "Compare\nwith the next one."}
        answer = stack.http.patch(here, json=patch)
        assert answer.status_code == 200
        view = stack.http.get(here).json()
        assert answer.json() == view
        assert view["waiting_for"] is not None
        assert (view["name"], view["labels"]) == ("a", {"team": "legs", "knee": "soft"})
        assert view["note"] == patch["note"] == view["spec"]["note"]
        said = stack.http.get(f"{here}/specification").json()
        assert (said["labels"], said["note"]) == (view["labels"], view["note"])
        removed = stack.http.patch(here, json={"name": None, "labels": None, "note": None}).json()
        assert (removed["name"], removed["labels"], removed["note"]) == (None, {}, None)
        assert removed["spec"] == {"kind": "train", "environment": {"id": "ant"}}

    def test_it_takes_the_media_type_of_the_standard(self, stack: Stack) -> None:
        stack.store.add(new := job())
        headers = {"Content-Type": "application/merge-patch+json"}
        answer = stack.http.patch(f"/jobs/{new.id}", content=b'{"name": "b"}', headers=headers)
        assert answer.json()["name"] == "b"
        answer = stack.http.patch(
            f"/jobs/{new.id}", content=b"name=b", headers={"Content-Type": "text/plain"}
        )
        assert "merge-patch+json" in problem(answer, 415, "unsupported-media-type")["detail"]

    def test_a_running_job_keeps_its_attempt_and_the_patch(self, stack: Stack) -> None:
        attempt = Attempt(stack, job())
        stack.http.patch(f"/jobs/{attempt.id}", json={"name": "renamed", "note": "Watch it."})
        attempt.keep("video.mp4")
        attempt.end()
        view = stack.http.get(f"/jobs/{attempt.id}").json()
        assert (view["status"], view["name"], view["note"]) == ("succeeded", "renamed", "Watch it.")
        assert stack.http.patch(f"/jobs/{attempt.id}", json={"note": "Done."}).json()["note"] == "Done."

    def test_a_submission_sent_again_gets_the_job_under_its_new_name(self, stack: Stack) -> None:
        sent = {"kind": "train", "environment": "ant", "name": "a"}
        first = stack.http.post("/jobs", json=sent, headers={"Idempotency-Key": "k"}).json()
        stack.http.patch(f"/jobs/{first['id']}", json={"name": "b"})
        again = stack.http.post("/jobs", json=sent, headers={"Idempotency-Key": "k"}).json()
        assert (again["id"], again["name"]) == (first["id"], "b")

    def test_it_is_found_by_what_it_is_called_now(self, stack: Stack) -> None:
        stack.store.add(new := job(name="old", labels={"team": "legs"}))
        stack.http.patch(
            f"/jobs/{new.id}", json={"name": "new", "labels": {"team": "arms"}, "note": "Knees."}
        )
        for query, number in {
            "name=new": 1,
            "name=old": 0,
            "label=team:arms": 1,
            "label=team:legs": 0,
        }.items():
            assert len(stack.http.get(f"/jobs?{query}").json()["items"]) == number, query
        assert len(stack.http.get("/jobs?search=KNEE").json()["items"]) == 1

    @pytest.mark.parametrize(
        ("sent", "pointer", "word"),
        [
            ({"status": "failed"}, "/status", "known are `name`, `labels`, `note`"),
            ({"id": UNKNOWN}, "/id", "is not a field here"),
            ({"nmae": "x"}, "/nmae", "did you mean `name`"),
            ({"name": "n" * 201}, "/name", "at most 200"),
            ({"name": 3}, "/name", "valid string"),
            ({"note": "n" * 4001}, "/note", "at most 4,000"),
            ({"note": "\0"}, "/note", "U+0000"),
            ({"labels": {"a b": "c"}}, "/labels/a b", "must match"),
            ({"labels": {"a": 1}}, "/labels/a", "valid string"),
            ({"labels": {f"b{n}": "" for n in range(64)}}, "/labels", "would have 65 labels"),
            ([], "", "object"),
        ],
    )
    def test_what_it_cannot_change_is_refused(self, stack: Stack, sent: Any, pointer: str, word: str) -> None:
        stack.store.add(new := job(labels={"a": ""}))
        document = problem(stack.http.patch(f"/jobs/{new.id}", json=sent), 422, "invalid-request")
        assert pointers(document) == [pointer]
        assert word in document["detail"]
        assert stack.store.get(new.id) == new

    def test_an_unknown_job_is_not_found(self, stack: Stack) -> None:
        for job_id in (UNKNOWN, "x"):
            problem(stack.http.patch(f"/jobs/{job_id}", json={}), 404, "job-not-found")

    def test_its_owner_and_admins_may_and_it_is_noted(self, lab: Lab) -> None:
        lab.stack.store.add(job(number(1)).model_copy(update={"owner": "ann", "project": "a"}))
        here = f"/jobs/{number(1)}"
        document = problem(lab.of("amy").patch(here, json={"name": "mine"}), 403, "forbidden")
        assert "belongs to ann" in document["detail"]
        problem(lab.of("bob").patch(here, json={"name": "mine"}), 404, "job-not-found")
        for user in ("ann", "root"):
            assert lab.of(user).patch(here, json={"name": user}).json()["name"] == user
        lab.service.audit_log.flush()
        noted = [(one.user, one.object) for one in lab.stack.store.audit(action="job.changed").entries]
        assert sorted(noted) == [("ann", f"job {number(1)}"), ("root", f"job {number(1)}")]
