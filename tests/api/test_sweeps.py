"""Sweeps over HTTP; the controller moves them on when a test says so."""

import json
import re
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.openapi import EXAMPLES
from core.jobs.job import Progress
from core.jobs.queue import queue_names
from core.jobs.status import JobStatus
from core.jobs.workers import WorkerInfo
from core.reasons import Reason
from core.sweeps.controller import SweepController
from core.sweeps.spec import SWEEP_SPEC
from core.sweeps.sweep import Sweep
from tests.api.conftest import NOON, Attempt, Stack
from tests.api.problems import pointers, problem

METRIC = "eval/episode_reward"
JOB = {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 1000}, "video": None}
GRID = {
    "name": "rates",
    "labels": {"project": "gaits"},
    "job": {**JOB, "labels": {"of": "job"}},
    "method": "grid",
    "parameters": {"algorithm.learning_rate": [1e-4, 1e-3], "seed": [1, 2]},
}


@pytest.fixture
def look(stack: Stack) -> Callable[[], int]:
    """The reconciler's part, once."""
    return SweepController(stack.store, stack.queue, stack.objects).run_once


def finish(
    stack: Stack,
    number: int,
    values: dict[str, float],
    end: JobStatus = JobStatus.SUCCEEDED,
    step: int = 1000,
) -> Attempt:
    """A worker does the trial of this number of the only sweep."""
    [sweep] = stack.http.get("/sweeps").json()["items"]
    trial = stack.http.get(f"/sweeps/{sweep['id']}").json()["trials"][number]
    attempt = Attempt(stack, stack.store.get(trial["job"]), is_new=False)
    progress = Progress(step=step, total=1000, metrics=values)
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id=f"{number}")
    reasons = {JobStatus.SUCCEEDED: Reason.COMPLETED, JobStatus.CANCELLED: Reason.USER_CANCELLED}
    attempt.end(end, reasons.get(end, Reason.DIVERGED))
    return attempt


def post(stack: Stack, **changes: Any) -> httpx.Response:
    return stack.http.post("/sweeps", json={**GRID, **changes})


def test_a_grid_takes_five_values_of_a_range_that_does_not_say_how_many(stack: Stack) -> None:
    rates = {"low": 1e-4, "high": 1e-3, "log": True}
    answer = post(stack, parameters={"seed": [1, 2], "algorithm.learning_rate": rates})
    assert (answer.status_code, answer.json()["max_trials"]) == (202, 10)


def test_a_sweep_goes_its_way(stack: Stack, look: Callable[[], int]) -> None:
    answer = post(stack)
    assert answer.status_code == 202
    sweep = answer.json()
    assert answer.headers["location"] == sweep["links"]["self"] == f"/sweeps/{sweep['id']}"
    assert (sweep["status"], sweep["max_trials"], sweep["trials"]) == ("running", 4, [])
    look()
    trials = stack.http.get(sweep["links"]["self"]).json()["trials"]
    assert [trial["parameters"] for trial in trials] == [
        {"algorithm.learning_rate": rate, "seed": seed} for rate in (1e-4, 1e-3) for seed in (1, 2)
    ]
    jobs = stack.http.get(sweep["links"]["jobs"]).json()["items"]
    assert {job["id"] for job in jobs} == {trial["job"] for trial in trials}
    first = stack.http.get(f"/jobs/{trials[0]['job']}").json()
    assert first["labels"] == {"of": "job", "project": "gaits", "sweep": sweep["id"], "trial": "0"}
    assert first["spec"]["algorithm"] == {"num_timesteps": 1000, "learning_rate": 1e-4}

    for number, value in enumerate((3.0, 5.0, 10.0)):
        finish(stack, number, {METRIC: value})
    finish(stack, 3, {}, JobStatus.FAILED)
    look()
    found = stack.http.get(sweep["links"]["self"]).json()
    assert found["status"] == "succeeded"
    assert found["message"] == "Every combination was tried: 3 succeeded, 1 failed."
    assert found["num_trials"] == {"succeeded": 3, "failed": 1}
    assert [trial["values"] for trial in found["trials"]] == [[3.0], [5.0], [10.0], [None]]
    assert [trial["number"] for trial in found["best"]] == [2]
    # Of 3 and 5: the mean is 4, the standard deviation √((1 + 1) / 1).
    assert found["groups"] == [
        {
            "parameters": {"algorithm.learning_rate": 1e-4},
            "trials": [0, 1],
            "mean": [4.0],
            "spread": [2**0.5],
        },
        {"parameters": {"algorithm.learning_rate": 1e-3}, "trials": [2, 3], "mean": [10.0], "spread": [None]},
    ]
    assert found["importance"] is None
    assert found["importance_note"] == "It needs 4 trials that succeeded, and has 3."
    [listed] = stack.http.get("/sweeps?status=succeeded").json()["items"]
    assert listed["id"] == sweep["id"]
    assert "trials" not in listed


def test_a_sweep_is_one_row_of_the_list_of_jobs(stack: Stack, look: Callable[[], int]) -> None:
    alone = stack.http.post("/jobs", json=JOB).json()["id"]
    sweep = post(stack).json()
    look()
    for number, value in enumerate((3.0, 5.0)):
        finish(stack, number, {METRIC: value})
    folded = stack.http.get("/jobs?sweep=folded").json()["items"]
    assert [item["sweep"] for item in folded] == [sweep["id"], None]
    assert folded[1]["id"] == alone
    # By the return it stands where its best trial does.
    [first, _] = stack.http.get("/jobs?sweep=folded&sort=return").json()["items"]
    assert first["progress"]["metrics"] == {METRIC: 5.0}
    assert stack.http.get(first["links"]["self"]).json()["sweep"] == sweep["id"]
    assert [item["id"] for item in stack.http.get("/jobs?sweep=none").json()["items"]] == [alone]
    trials = stack.http.get("/jobs", params={"sweep": sweep["id"], "sort": "return", "order": "asc"}).json()
    assert [item["labels"]["trial"] for item in trials["items"][:2]] == ["0", "1"]
    [row] = stack.http.get("/sweeps", params={"id": [sweep["id"], alone]}).json()["items"]
    assert row["num_trials"] == {"succeeded": 2, "queued": 2}
    document = problem(stack.http.get("/sweeps?id=mine"), 422, "invalid-request")
    assert pointers(document) == ["/id"]


def test_what_matters_is_important(stack: Stack, look: Callable[[], int]) -> None:
    post(
        stack,
        parameters={"algorithm.learning_rate": [1e-4, 1e-3, 1e-2], "seed": [1, 2, 3]},
        budget={"parallel": 9},
    )
    look()
    for number in range(9):  # The rate decides, the seed does next to nothing.
        finish(stack, number, {METRIC: 100.0 * (number // 3) + number % 3})
    look()
    [sweep] = stack.http.get("/sweeps").json()["items"]
    shares = stack.http.get(sweep["links"]["self"]).json()["importance"][METRIC]
    assert shares["algorithm.learning_rate"] > shares["seed"]
    assert sum(shares.values()) == pytest.approx(1)


def test_one_key_makes_one_sweep(stack: Stack) -> None:
    headers = {"Idempotency-Key": "again"}
    first, second = (stack.http.post("/sweeps", json=GRID, headers=headers).json()["id"] for _ in range(2))
    assert first == second
    other = stack.http.post("/sweeps", json={**GRID, "name": "another"}, headers=headers)
    problem(other, 409, "idempotency-key-reused")


def test_a_cancel_takes_all_trials_with_it_and_a_resumed_sweep_goes_on(
    stack: Stack, look: Callable[[], int]
) -> None:
    here = post(stack, budget={"parallel": 2}).json()["links"]["self"]
    look()
    running = Attempt(stack, stack.store.get(stack.http.get(here).json()["trials"][0]["job"]), is_new=False)
    cancelled = stack.http.post(f"{here}/cancel")
    assert (cancelled.status_code, cancelled.json()["status"]) == (202, "cancelling")
    problem(stack.http.post(f"{here}/resume", json={"budget": {}}), 409, "sweep-not-finished")
    problem(stack.http.delete(here), 409, "sweep-not-finished")
    look()
    assert [one["status"] for one in stack.http.get(here).json()["trials"]] == ["cancelling", "cancelled"]
    running.end(JobStatus.CANCELLED, Reason.USER_CANCELLED)
    look()
    found = stack.http.get(here).json()
    assert (found["status"], found["message"]) == ("cancelled", "It was cancelled: 2 cancelled.")
    assert stack.http.post(f"{here}/cancel").json()["status"] == "cancelled"

    resumed = stack.http.post(f"{here}/resume", json={"budget": {"parallel": 1}})
    assert (resumed.status_code, resumed.json()["status"]) == (202, "running")
    look()
    assert [one["number"] for one in stack.http.get(here).json()["trials"]] == [0, 1, 2]
    finish(stack, 2, {METRIC: 1.0})
    look()
    finish(stack, 3, {METRIC: 1.0})
    look()
    ended = stack.http.post(f"{here}/cancel")
    problem(ended, 409, "sweep-finished")
    refused = problem(stack.http.post(f"{here}/resume", json={"budget": {"jobs": 9}}), 422, "invalid-request")
    assert refused["detail"] == (
        "Every combination was tried, so no further trial would start; no budget changes that: start another "
        "sweep."
    )


def test_a_sweep_is_changed_and_its_next_trials_have_its_labels(
    stack: Stack, look: Callable[[], int]
) -> None:
    spec = {"job": {"kind": "train", "environment": "ant"}, "method": "grid", "parameters": {"seed": [1, 2]}}
    sent = {**spec, "name": "a", "labels": {"draft": "1"}, "budget": {"parallel": 1}}
    here = stack.http.post("/sweeps", json=sent).headers["Location"]
    look()
    patch = {"name": None, "labels": {"team": "legs", "draft": None}, "note": "Compare\nwith the last."}
    answer = stack.http.patch(here, json=patch)
    assert answer.json() == stack.http.get(here).json()
    assert (answer.json()["name"], answer.json()["labels"]) == (None, {"team": "legs"})
    assert answer.json()["note"] == patch["note"] == answer.json()["spec"]["note"]
    first = stack.http.get("/jobs").json()["items"][0]
    assert stack.http.patch(f"/jobs/{first['id']}", json={}).json()["sweep"] == here.rpartition("/")[2]
    stack.http.post(f"/jobs/{first['id']}/cancel")
    look()
    look()
    second = stack.http.get("/jobs").json()["items"][0]
    assert [{"team", "draft"} & set(one["labels"]) for one in (first, second)] == [{"draft"}, {"team"}]
    # It has one already.
    many = {"labels": {f"l{n}": "" for n in range(60)}}
    document = problem(stack.http.patch(here, json=many), 422, "invalid-request")
    assert document["detail"] == "The sweep would have 61 labels; at most 60 are allowed."
    del many["labels"]["l0"]
    assert stack.http.patch(here, json=many).status_code == 200
    assert len(stack.http.get(here).json()["labels"]) == 60
    problem(stack.http.patch("/sweeps/019aa3c2f0b1-5be0c1d2e3", json={}), 404, "sweep-not-found")


def test_a_changed_sweep_leaves_room_for_the_labels_of_its_job(stack: Stack) -> None:
    labels = {f"j{n}": "" for n in range(3)}
    job = {"kind": "train", "environment": "ant", "labels": labels}
    here = stack.http.post("/sweeps", json={"job": job, "method": "grid", "parameters": {"seed": [1]}})
    many = {"labels": {f"l{n}": "" for n in range(60)}}
    document = problem(stack.http.patch(here.headers["Location"], json=many), 422, "invalid-request")
    assert "labels together" in document["detail"]


def test_a_deleted_sweep_leaves_its_jobs(stack: Stack, look: Callable[[], int]) -> None:
    here = post(stack, parameters={"seed": [1]}).json()["links"]["self"]
    look()
    job = finish(stack, 0, {METRIC: 1.0}).id
    look()
    assert stack.http.delete(here).status_code == 204
    problem(stack.http.get(here), 404, "sweep-not-found")
    assert stack.http.get(f"/jobs/{job}").status_code == 200


def test_a_deleted_trial_keeps_its_values(stack: Stack, look: Callable[[], int]) -> None:
    here = post(stack).json()["links"]["self"]
    look()
    done, gone = finish(stack, 0, {METRIC: 1.0}).id, finish(stack, 1, {METRIC: 2.0}).id
    stack.http.delete(f"/jobs/{gone}")  # Before its end was seen.
    look()
    stack.http.delete(f"/jobs/{done}")
    first, second, *_ = stack.http.get(here).json()["trials"]
    assert (first["job"], first["status"], first["values"]) == (None, "succeeded", [1.0])
    assert (second["job"], second["status"]) == (None, "deleted")


def test_several_objectives_have_a_front(stack: Stack, look: Callable[[], int]) -> None:
    objectives = [{"metric": METRIC}, {"metric": "eval/avg_episode_length", "direction": "minimize"}]
    here = post(stack, objective=objectives).json()["links"]["self"]
    look()
    for number, (reward, length) in enumerate([(1, 10), (2, 20), (2, 30), (0, 10)]):
        finish(stack, number, {METRIC: float(reward), "eval/avg_episode_length": float(length)})
    look()
    # (2, 30) is beaten by (2, 20), and (0, 10) by (1, 10).
    assert [one["number"] for one in stack.http.get(here).json()["best"]] == [0, 1]


def test_a_setting_that_does_not_fit_is_refused_and_counts(stack: Stack, look: Callable[[], int]) -> None:
    """The checks at submission try some values of a long range; one between them may still not fit."""
    parameters = {"algorithm.num_minibatches": [8, 3], "seed": [1]}
    refused = problem(post(stack, parameters=parameters), 422, "invalid-request")
    assert "/parameters/algorithm.num_minibatches" in pointers(refused)
    spec = SWEEP_SPEC.validate_python({**GRID, "parameters": parameters, "labels": {}})
    sweep = stack.store.add_sweep(Sweep(id="019aa3c2f0b1-5be0c1d2e3", spec=spec, created_at=NOON))
    look()
    first, second = stack.http.get(f"/sweeps/{sweep.id}").json()["trials"]
    assert (first["status"], second["status"], second["job"]) == ("queued", "refused", None)
    assert "num_minibatches" in second["message"]
    finish(stack, 0, {METRIC: 1.0})
    look()
    assert stack.http.get(f"/sweeps/{sweep.id}").json()["message"].endswith("1 succeeded, 1 refused.")


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_the_examples_are_accepted(stack: Stack, name: str) -> None:
    answer = stack.http.post("/sweeps", json=EXAMPLES[name]["value"])
    assert answer.status_code == 202, answer.text


def test_the_ablations_of_the_docs_are_accepted(stack: Stack, look: Callable[[], int]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "neuroscience.md").read_text()
    [example] = re.findall(r"```json\n(.*?)```", page.split("## Ablations")[1], re.DOTALL)
    answer = stack.http.post("/sweeps", json=json.loads(example))
    assert answer.status_code == 202, answer.text
    look()
    first = stack.http.get(f"/sweeps/{answer.json()['id']}").json()["trials"][0]
    spec = stack.http.get(f"/jobs/{first['job']}").json()["spec"]
    assert spec["algorithm"]["network"] == {
        **{"kind": "intention", "latent": 4, "kl_weight": 0.0},
        "encoder_sees": ["command", "gait_phase"],
    }
    assert spec["environment"]["options"]["observation"][0] == {"kind": "projected_gravity"}


def test_what_is_no_sweep_is_not_found(stack: Stack) -> None:
    for path in ("/sweeps/..%2f", "/sweeps/019aa3c2f0b1-5be0c1d2e3", "/sweeps/x"):
        assert stack.http.get(path).status_code == 404
    problem(stack.http.post("/sweeps/019aa3c2f0b1-5be0c1d2e3/cancel"), 404, "sweep-not-found")
    problem(stack.http.post("/sweeps", content=b"{"), 415, "unsupported-media-type")


def test_the_record_away_is_said_so(stack: Stack) -> None:
    with stack.away("store"):
        problem(stack.http.get("/sweeps"), 503, "records-unavailable")
        problem(post(stack), 503, "records-unavailable")


ON_A_GPU = {**JOB, "resources": {"accelerator": "gpu"}}


def test_the_seeds_of_a_grid_are_trained_together_on_a_gpu(stack: Stack, look: Callable[[], int]) -> None:
    answer = post(stack, job={**ON_A_GPU, "seed": 9}, budget={"steps": 4000})
    sweep = answer.json()
    assert (answer.status_code, sweep["max_trials"]) == (202, 2)
    assert sweep["spec"]["job"]["seeds"] == [1, 2]
    assert "seed" not in sweep["spec"]["job"]
    look()
    trials = stack.http.get(sweep["links"]["self"]).json()["trials"]
    rates = [1e-4, 1e-3]
    assert [trial["parameters"] for trial in trials] == [{"algorithm.learning_rate": rate} for rate in rates]
    jobs = [stack.http.get(f"/jobs/{trial['job']}").json()["spec"] for trial in trials]
    assert [job["seeds"] for job in jobs] == [[1, 2], [1, 2]]
    assert [job["algorithm"]["learning_rate"] for job in jobs] == rates
    for number, value in enumerate((4.0, 6.0)):
        finish(stack, number, {METRIC: value, f"seed_1/{METRIC}": 0.0})
    look()
    ended = stack.http.get(sweep["links"]["self"]).json()
    assert (ended["status"], ended["best"][0]["number"], ended["best"][0]["values"]) == (
        "succeeded",
        1,
        [6.0],
    )
    stored = stack.store.trials([sweep["id"]])[sweep["id"]]
    assert [trial.steps for trial in stored] == [2000, 2000]  # Those of both seeds.


def test_a_grid_of_seeds_alone_is_one_job_of_them(stack: Stack, look: Callable[[], int]) -> None:
    axis = {"low": 3, "high": 5, "step": 1}
    sweep = post(stack, job=ON_A_GPU, parameters={"seed": axis}).json()
    assert (sweep["max_trials"], sweep["spec"]["parameters"]) == (1, {})
    look()
    [trial] = stack.http.get(sweep["links"]["self"]).json()["trials"]
    assert stack.http.get(f"/jobs/{trial['job']}").json()["spec"]["seeds"] == [3, 4, 5]
    finish(stack, 0, {METRIC: 4.0})
    look()
    assert stack.http.get(sweep["links"]["self"]).json()["status"] == "succeeded"


@pytest.mark.parametrize(
    "changes",
    [
        {"job": JOB},  # A CPU may train it.
        {"method": "random", "budget": {"jobs": 4}},
        {"parameters": {"seed": list(range(17))}},
        {"parameters": {"seed": [1]}},
        {"parameters": {"seed": [1, 2], "resources.accelerator": ["gpu", "any"]}},
        {"job": {**JOB, "resources": {"gpus": 2}}},
        {
            "job": {
                "kind": "train",
                "environment": "brittle_star",
                "algorithm": {"kind": "q_learning"},
                "resources": {"accelerator": "gpu"},
            },
            "parameters": {"seed": [1, 2]},
            "objective": {"metric": METRIC},
        },
    ],
    ids=["cpu", "random", "too many", "one", "accelerators", "gpus", "q_learning"],
)
def test_otherwise_each_seed_is_a_job(stack: Stack, changes: dict[str, Any]) -> None:
    answer = post(stack, **{"job": ON_A_GPU, "parameters": {"seed": [1, 2]}, **changes})
    assert answer.status_code == 202, answer.text
    sweep = answer.json()["spec"]
    assert "seed" in sweep["parameters"]
    assert "seeds" not in sweep["job"]


def test_seeds_that_do_not_fit_together_are_jobs_of_their_own(stack: Stack) -> None:
    info = WorkerInfo(
        name="w",
        host="h",
        pid=1,
        device="gpu:0",
        queues=queue_names("gpu:0"),
        memory_bytes=20 * 2**30,
        started_at=NOON,
        seen_at=NOON,
    )
    stack.store.announce(info, timedelta(minutes=1))
    # 1024 * 1024 * 100 transitions of 39 floats: 15.2 GiB.
    large = {"num_envs": 1024, "batch_size": 1024, "num_minibatches": 1024, "unroll_length": 100}
    answer = post(stack, job={**ON_A_GPU, "algorithm": large}, parameters={"seed": [1, 2]})
    assert (answer.status_code, answer.json()["max_trials"]) == (202, 2)
