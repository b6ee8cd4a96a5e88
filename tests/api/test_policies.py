"""A job's policy in the forms that clients ask for, and what is refused."""

from typing import Any

import pytest

from core.jobs.status import JobStatus
from core.reasons import Reason
from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import problem

ID = "019aa3c2f0b1-5be0c1d2e3"
ADDRESS = f"/jobs/{ID}/policy"
FORMS = {
    None: ("policy", b"own"),
    "numpy": ("policy.npz", b"arrays"),
    "onnx": ("policy.onnx", b"graph"),
    "robot": ("policy.robot.onnx", b"whole graph"),
}
BEST = {
    "policy-best": b"best own",
    "policy-best.npz": b"best arrays",
    "policy-best.onnx": b"best graph",
    "policy-best.robot.onnx": b"best whole graph",
}
TABLE: dict[str, Any] = {"environment": {"id": "brittle_star"}, "algorithm": {"kind": "q_learning"}}


def keep(attempt: Attempt, *forms: str | None) -> None:
    for form in forms:
        name, body = FORMS[form]
        role = "export" if form else "policy"
        attempt.keep(name, body, role=role, media_type="application/octet-stream", step=9)


def asked(stack: Stack, form: str | None) -> Any:
    return stack.http.get(ADDRESS, params={} if form is None else {"format": form})


@pytest.mark.parametrize("form", FORMS)
def test_a_policy_comes_in_the_form_that_is_asked_for(stack: Stack, form: str | None) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, *FORMS)
    attempt.end()
    answer = asked(stack, form)
    name, body = FORMS[form]
    assert (answer.status_code, answer.content) == (200, body)
    assert answer.headers["Content-Disposition"].endswith(f"''{name}")
    known = {"If-None-Match": answer.headers["ETag"]}
    assert stack.http.get(answer.url, headers=known).status_code == 304
    assert stack.http.head(answer.url).headers["Content-Length"] == str(len(body))
    assert stack.http.get(f"/jobs/{ID}").json()["links"]["policy"] == ADDRESS


@pytest.mark.parametrize("form", FORMS)
def test_a_policy_that_may_come_says_when_to_ask_again(stack: Stack, form: str | None) -> None:
    stack.store.add(job(ID))
    answer = asked(stack, form)
    detail = problem(answer, 404, "artifact-not-ready")["detail"]
    assert f"is queued and has no {FORMS[form][0]} yet" in detail
    assert int(answer.headers["Retry-After"]) > 0


def test_an_export_that_is_on_its_way_may_come(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, None)
    assert "has no policy.onnx yet" in problem(asked(stack, "onnx"), 404, "artifact-not-ready")["detail"]


def test_a_checkpoints_export_is_no_final_policy(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, "numpy")
    detail = problem(asked(stack, "numpy"), 404, "artifact-not-ready")["detail"]
    assert "has no final policy.npz yet. It has policy.npz." in detail
    assert stack.http.get(f"/jobs/{ID}/artifacts/policy.npz").content == b"arrays"
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    # There will be no later one.
    assert asked(stack, "numpy").content == b"arrays"


@pytest.mark.parametrize("form", FORMS)
def test_the_best_policy_comes_in_the_same_forms(stack: Stack, form: str | None) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, *FORMS)
    for name, body in BEST.items():
        role = "best_policy" if name == "policy-best" else "export"
        attempt.keep(name, body, role=role, media_type="application/octet-stream", step=5)
    attempt.end()
    query = {"which": "best"} if form is None else {"which": "best", "format": form}
    answer = stack.http.get(ADDRESS, params=query)
    name = FORMS[form][0].replace("policy", "policy-best")
    assert (answer.status_code, answer.content) == (200, BEST[name])
    assert answer.headers["Content-Disposition"].endswith(f"''{name}")
    assert asked(stack, form).content == FORMS[form][1]


def test_an_export_of_an_earlier_best_policy_is_not_the_best_ones(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    for name, role, step in (("policy-best.npz", "export", 5), ("policy-best", "best_policy", 9)):
        attempt.keep(name, BEST[name], role=role, media_type="application/octet-stream", step=step)
    query = {"which": "best", "format": "numpy"}
    detail = problem(stack.http.get(ADDRESS, params=query), 404, "artifact-not-ready")["detail"]
    assert "has no policy-best.npz yet" in detail
    attempt.end(JobStatus.FAILED, Reason.OUT_OF_MEMORY)
    detail = problem(stack.http.get(ADDRESS, params=query), 404, "artifact-not-found")["detail"]
    assert "has a policy-best and no policy-best.npz" in detail
    assert stack.http.get(ADDRESS, params={"which": "best"}).content == b"best own"


def test_without_an_evaluation_there_is_no_best_policy(stack: Stack) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, None)
    attempt.end()
    answer = stack.http.get(ADDRESS, params={"which": "best"})
    assert "without a policy-best" in problem(answer, 404, "artifact-not-found")["detail"]


@pytest.mark.parametrize("form", FORMS)
def test_a_policy_that_never_comes_says_why(stack: Stack, form: str | None) -> None:
    attempt = Attempt(stack, job(ID))
    attempt.end(JobStatus.FAILED, Reason.DIVERGED)
    answer = asked(stack, form)
    detail = problem(answer, 404, "artifact-not-found")["detail"]
    assert f"failed (diverged: It came to its end.) without a {FORMS[form][0]}" in detail
    assert "Retry-After" not in answer.headers


@pytest.mark.parametrize("form", ["numpy", "onnx", "robot"])
def test_a_policy_without_exports_offers_its_own_file(stack: Stack, form: str) -> None:
    attempt = Attempt(stack, job(ID))
    keep(attempt, None)
    attempt.end()
    detail = problem(asked(stack, form), 404, "artifact-not-found")["detail"]
    assert f"has a policy and no {FORMS[form][0]}" in detail
    assert asked(stack, None).content == b"own"


@pytest.mark.parametrize("form", ["numpy", "onnx"])
def test_of_a_table_no_network_is_made(stack: Stack, form: str) -> None:
    # Known before the job has run.
    attempt = Attempt(stack, job(ID, **TABLE))
    document = problem(asked(stack, form), 422, "invalid-request")
    assert [place["pointer"] for place in document["errors"]] == ["/format"]
    assert f"no policy of q_learning as {form}: it is a table" in document["detail"]
    assert "The artifact `tables.npz` of an ended job is that table" in document["detail"]
    keep(attempt, None)
    assert asked(stack, None).content == b"own"


@pytest.mark.parametrize("form", ["numpy", "onnx"])
def test_a_network_of_choices_is_not_written_as_actions(stack: Stack, form: str) -> None:
    Attempt(stack, job(ID, **(TABLE | {"algorithm": {"kind": "dqn"}})))
    document = problem(asked(stack, form), 422, "invalid-request")
    assert [place["pointer"] for place in document["errors"]] == ["/format"]
    assert f"no policy of dqn as {form}" in document["detail"]


def test_a_rollout_has_no_policy_of_its_own(stack: Stack) -> None:
    stack.store.add(job(ID, kind="rollout", policy={"kind": "random"}))
    answer = asked(stack, None)
    assert "is a rollout, which trains no policy" in problem(answer, 404, "artifact-not-found")["detail"]
    assert "Retry-After" not in answer.headers


@pytest.mark.parametrize("form", ["tflite", "", "ONNX"])
def test_an_unknown_format_is_refused_with_those_that_there_are(stack: Stack, form: str) -> None:
    stack.store.add(job(ID))
    document = problem(asked(stack, form), 422, "invalid-request")
    assert [place["pointer"] for place in document["errors"]] == ["/format"]
    assert "'numpy', 'onnx' or 'robot'" in document["detail"]


def test_of_an_unknown_job_there_is_no_policy(stack: Stack) -> None:
    problem(asked(stack, "onnx"), 404, "job-not-found")
