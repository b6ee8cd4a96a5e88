"""Trainings of several seeds: what is refused, and whose files a client gets."""

from typing import Any

import pytest

from tests.api.conftest import Attempt, Stack, job
from tests.api.problems import pointers, problem

ID = "019aa3c2f0b1-5be0c1d2e3"
MINIMAL: dict[str, Any] = {"kind": "train", "environment": "ant", "seeds": [4, 0]}


@pytest.fixture
def trained(stack: Stack) -> Attempt:
    """A training of the seeds 4 and 0, with a checkpoint and each one's files."""
    attempt = Attempt(stack, job(ID, seeds=[4, 0]))
    attempt.keep(
        "checkpoint-000000000009.msgpack", role="checkpoint", media_type="application/msgpack", step=9
    )
    for seed in (4, 0):
        for name, role in (
            (f"policy-seed-{seed}", "policy"),
            (f"policy-seed-{seed}.npz", "export"),
            (f"policy-best-seed-{seed}", "best_policy"),
            (f"video-seed-{seed}.mp4", "video"),
            (f"video-seed-{seed}.png", "poster"),
            (f"replay-seed-{seed}.bin", "replay"),
        ):
            attempt.keep(name, f"{name} of {seed}".encode(), role=role, step=9, metadata={"seed": seed})
    return attempt


@pytest.mark.parametrize(
    ("document", "places", "words"),
    [
        (MINIMAL | {"seed": 3}, [""], "`seed` and `seeds` exclude each other"),
        (MINIMAL | {"seeds": [1, 1]}, ["/seeds"], "each seed must be there once"),
        (MINIMAL | {"seeds": [1]}, ["/seeds"], "at least 2"),
        (MINIMAL | {"resources": {"gpus": 2}}, ["/seeds", "/resources/gpus"], "trained on one device"),
        (
            MINIMAL | {"environment": "brittle_star", "algorithm": {"kind": "q_learning"}},
            ["/seeds"],
            "q_learning takes no `seeds`: its `agents` learn side by side already",
        ),
    ],
)
def test_what_cannot_be_is_refused_where_it_stands(
    stack: Stack, document: dict[str, Any], places: list[str], words: str
) -> None:
    refused = problem(stack.http.post("/jobs", json=document), 422, "invalid-request")
    assert pointers(refused) == places
    assert words in str(refused["errors"])
    assert stack.is_empty()


def test_a_policy_a_video_and_a_replay_are_of_the_seed_that_is_asked_for(
    stack: Stack, trained: Attempt
) -> None:
    for query, seed in (({}, 4), ({"seed": 4}, 4), ({"seed": 0}, 0)):
        for part, name in (
            ("policy", f"policy-seed-{seed}"),
            ("policy?which=best", f"policy-best-seed-{seed}"),
            ("video", f"video-seed-{seed}.mp4"),
            ("poster?step=9", f"video-seed-{seed}.png"),
            ("replay", f"replay-seed-{seed}.bin"),
        ):
            answer = stack.http.get(f"/jobs/{ID}/{part}", params=dict(query) or None)
            if query and "?" in part:
                answer = stack.http.get(f"/jobs/{ID}/{part}&seed={seed}")
            assert answer.content == f"{name} of {seed}".encode(), answer.text
    trained.end()
    exported = stack.http.get(f"/jobs/{ID}/policy", params={"format": "numpy", "seed": 0})
    assert exported.content == b"policy-seed-0.npz of 0"


@pytest.mark.parametrize("part", ["policy", "video", "poster", "replay"])
def test_a_seed_that_the_job_does_not_have_is_refused(stack: Stack, trained: Attempt, part: str) -> None:
    refused = problem(stack.http.get(f"/jobs/{ID}/{part}?seed=7"), 404, "artifact-not-found")
    assert refused["detail"] == f"Job {ID} has no seed 7; it has 4, 0."


def test_a_file_that_a_seed_lacks_is_said_to_be_its(stack: Stack) -> None:
    Attempt(stack, job(ID, seeds=[4, 0]))
    for part in ("policy", "video", "replay"):
        detail = problem(stack.http.get(f"/jobs/{ID}/{part}?seed=0"), 404, "artifact-not-ready")["detail"]
        assert "seed-0 yet" in detail or "of seed 0 yet" in detail


def test_a_job_with_one_seed_has_the_files_of_that_one(stack: Stack) -> None:
    Attempt(stack, job(ID, seed=3)).keep("video.mp4", b"film")
    assert stack.http.get(f"/jobs/{ID}/video?seed=3").content == b"film"
    answer = stack.http.get(f"/jobs/{ID}/video?seed=4")
    assert problem(answer, 404, "artifact-not-found")["detail"].endswith("3.")


def test_a_rollout_acts_by_the_policy_of_a_seed(stack: Stack, trained: Attempt) -> None:
    for policy in ({}, {"seed": 0}, {"seed": 4, "which": "best"}, {"seed": 0, "step": 9}):
        sent = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": ID, **policy}}
        answer = stack.http.post("/jobs", json=sent)
        assert answer.status_code == 202, answer.text
        assert answer.json()["spec"]["policy"] == sent["policy"]
    sent = {"kind": "rollout", "policy": {"kind": "checkpoint", "job": ID, "seed": 1}}
    assert pointers(problem(stack.http.post("/jobs", json=sent), 422, "invalid-request")) == ["/policy/seed"]


def test_a_training_resumes_from_the_same_seeds_alone(stack: Stack, trained: Attempt) -> None:
    sent = {"kind": "train", "environment": "ant", "resume_from": {"job": ID}}
    assert stack.http.post("/jobs", json={**sent, "seeds": [4, 0]}).status_code == 202
    for other in ({"seeds": [0, 4]}, {"seeds": [4, 0, 1]}, {"seed": 4}):
        refused = problem(stack.http.post("/jobs", json={**sent, **other}), 422, "invalid-request")
        assert pointers(refused) == ["/seeds", "/resume_from"]
        assert "The checkpoint is of the seeds [4, 0], and this job trains" in refused["detail"]


def test_a_population_has_seeds_of_its_own(stack: Stack) -> None:
    sweep = {
        "job": {**MINIMAL, "algorithm": {"num_timesteps": 10_000_000}},
        "method": "pbt",
        "parameters": {"algorithm.learning_rate": {"low": 1e-4, "high": 1e-3}},
        "population": {"size": 4, "generations": 2},
    }
    refused = problem(stack.http.post("/sweeps", json=sweep), 422, "invalid-request")
    assert pointers(refused) == ["/job/seeds"]
