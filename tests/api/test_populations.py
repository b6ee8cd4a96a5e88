"""Sweeps by population-based training over HTTP; the controller moves them on when a test says so."""

from collections.abc import Callable
from typing import Any

import pytest

from core.algorithms.ppo.spec import PPOSpec
from core.jobs.job import Progress
from core.jobs.status import JobStatus
from core.reasons import Reason
from core.sweeps.controller import SweepController
from tests.api.conftest import Attempt, Stack
from tests.api.problems import pointers, problem

METRIC = "eval/episode_reward"
RATE = "algorithm.learning_rate"
# Updates of 64 × 8 × 5 = 2,560 steps on every device.
ALGORITHM = {
    "num_timesteps": 10_240,
    "num_envs": 64,
    "batch_size": 64,
    "num_minibatches": 8,
    "unroll_length": 5,
}
JOB = {"kind": "train", "environment": "ant", "algorithm": ALGORITHM, "video": None, "seed": 3}
SWEEP = {
    "job": JOB,
    "method": "pbt",
    "parameters": {RATE: {"low": 1e-4, "high": 1e-2, "log": True}},
    "population": {"size": 2, "generations": 2, "resample_probability": 0.0},
}


@pytest.fixture
def look(stack: Stack) -> Callable[[], int]:
    """The reconciler's part, once."""
    return SweepController(stack.store, stack.queue, stack.objects).run_once


def train(stack: Stack, trial: dict[str, Any], value: float, *, until: int, keeps: bool = True) -> Attempt:
    """A worker does the trial, on a GPU, where other values are tuned."""
    attempt = Attempt(stack, stack.store.get(trial["job"]), is_new=False)
    hyperparameters = PPOSpec.model_validate({**ALGORITHM, "policy_hidden_layer_sizes": [5]}).model_dump()
    attempt.claim.start(device="cuda:0", engine="mjx", details={"hyperparameters": hyperparameters})
    progress = Progress(step=until, total=until, metrics={METRIC: value})
    stack.store.record(attempt.id, attempt.claim.token, "events", [], progress, write_id="w")
    if keeps:
        attempt.keep(f"checkpoint-{until}", role="checkpoint", step=until)
    attempt.end()
    return attempt


def read(stack: Stack, here: str) -> dict[str, Any]:
    return stack.http.get(here).json()


def test_a_loser_resumes_from_the_winners_checkpoint(stack: Stack, look: Callable[[], int]) -> None:
    answer = stack.http.post("/sweeps", json=SWEEP)
    assert answer.status_code == 202, answer.text
    assert answer.json()["max_trials"] == 4
    here = answer.json()["links"]["self"]
    look()
    first = read(stack, here)["trials"]
    assert [(one["generation"], one["parent"]) for one in first] == [(0, None), (0, None)]
    specs = [stack.store.get(one["job"]).spec for one in first]
    assert [(one.seed, one.algorithm.num_timesteps) for one in specs] == [(3, 5120), (4, 5120)]
    train(stack, first[0], 1.0, until=5120)
    look()
    assert len(read(stack, here)["trials"]) == 2  # The generation is not over.
    winner = train(stack, first[1], 2.0, until=5120)
    look()
    loser, kept = read(stack, here)["trials"][2:]
    assert [(one["generation"], one["parent"]) for one in (loser, kept)] == [(1, 1), (1, 1)]
    assert (loser["status"], loser["message"]) == ("queued", None)
    won, factor = first[1]["parameters"][RATE], loser["parameters"][RATE] / first[1]["parameters"][RATE]
    assert kept["parameters"] == {RATE: won}
    assert min(abs(factor - one) for one in (0.8, 1.2)) < 1e-9
    spec = stack.http.get(f"/jobs/{loser['job']}").json()["spec"]
    assert spec["resume_from"]["job"] == winner.id
    # Values tuned for another device would not fit the checkpoint, so the child has its parent's.
    assert spec["algorithm"]["policy_hidden_layer_sizes"] == [5]
    assert spec["algorithm"]["num_timesteps"] == 10_240
    assert spec["algorithm"]["learning_rate"] == loser["parameters"][RATE]

    train(stack, loser, 4.0, until=10_240)
    train(stack, kept, 3.0, until=10_240)
    look()
    found = read(stack, here)
    assert (found["status"], found["message"]) == ("succeeded", "Every generation was trained: 4 succeeded.")
    # Each trained its own half.
    assert [one["step"] for one in found["trials"]] == 4 * [5120]
    assert [one["number"] for one in found["best"]] == [2]
    assert found["importance"] is None
    assert found["importance_note"].startswith("The method `pbt` changes settings while a run trains")


def test_without_the_parents_checkpoint_a_trial_is_refused_and_the_sweep_goes_on(
    stack: Stack, look: Callable[[], int]
) -> None:
    here = stack.http.post("/sweeps", json=SWEEP).json()["links"]["self"]
    look()
    first = read(stack, here)["trials"]
    winner = train(stack, first[0], 2.0, until=5120, keeps=False)
    train(stack, first[1], 1.0, until=5120)
    look()
    found = read(stack, here)
    assert [one["status"] for one in found["trials"][2:]] == ["refused", "refused"]
    assert found["trials"][2]["message"] == f"Job {winner.id} (succeeded) has no checkpoint."
    look()
    ended = read(stack, here)
    assert (ended["status"], ended["message"]) == (
        "succeeded",
        "Every generation was trained: 2 succeeded, 2 refused.",
    )


def test_a_population_of_which_none_is_left_fails(stack: Stack, look: Callable[[], int]) -> None:
    here = stack.http.post("/sweeps", json=SWEEP).json()["links"]["self"]
    look()
    for trial in read(stack, here)["trials"]:
        Attempt(stack, stack.store.get(trial["job"]), is_new=False).end(JobStatus.FAILED, Reason.DIVERGED)
    look()
    found = read(stack, here)
    sentence = "No trial of generation 0 has a value and a job to resume from: 2 failed."
    assert (found["status"], found["message"]) == ("failed", sentence)


def test_a_cancelled_population_is_resumed_with_its_generation_again(
    stack: Stack, look: Callable[[], int]
) -> None:
    here = stack.http.post("/sweeps", json=SWEEP).json()["links"]["self"]
    look()
    for number, trial in enumerate(read(stack, here)["trials"]):
        train(stack, trial, float(number), until=5120)
    look()
    stack.http.post(f"{here}/cancel").raise_for_status()
    look()
    look()
    assert read(stack, here)["status"] == "cancelled"
    resumed = stack.http.post(f"{here}/resume", json={"budget": {}})
    assert resumed.json()["max_trials"] == 6
    look()
    again = read(stack, here)["trials"]
    assert [(one["generation"], one["parent"], one["status"]) for one in again[2:]] == [
        *[(1, 1, "cancelled")] * 2,
        *[(1, 1, "queued")] * 2,
    ]
    for trial in again[4:]:
        train(stack, trial, 3.0, until=10_240)
    look()
    found = read(stack, here)
    sentence = "Every generation was trained: 4 succeeded, 2 cancelled."
    assert (found["status"], found["message"]) == ("succeeded", sentence)


def of_algorithm(**said: Any) -> dict[str, Any]:
    return {**JOB, "algorithm": {**ALGORITHM, **said}}


@pytest.mark.parametrize(
    ("changes", "pointer", "sentence"),
    [
        (
            {"method": "random", "budget": {"jobs": 4}},
            "/population",
            "`population` is for the method `pbt`, and this sweep has `random`; leave it out.",
        ),
        (
            {"population": None},
            "/population",
            'The method `pbt` needs a population, for example `{"size": 8, "generations": 10}`.',
        ),
        ({"population": {"size": 8}}, "/population/generations", None),
        ({"population": {"size": 1, "generations": 2}}, "/population/size", None),
        ({"population": {"size": 2, "generations": 2, "truncation": 0.6}}, "/population/truncation", None),
        (
            {"population": {"size": 100, "generations": 11}},
            "/population",
            None,
        ),
        (
            {"population": {"size": 2, "generations": 5}},
            "/population/generations",
            "A generation has 2,048 steps, and an update on a CPU takes 2,560: raise num_timesteps, take "
            "fewer generations, or ask for another `job.resources.accelerator`.",
        ),
        (
            {"objective": [{"metric": METRIC}, {"metric": "eval/avg_episode_length"}]},
            "/objective",
            "The method `pbt` compares trials by one objective; give one.",
        ),
        (
            {"pruning": {"kind": "median"}},
            "/pruning",
            "The method `pbt` replaces the worst trials itself; leave `pruning` out.",
        ),
        (
            {
                "job": {"kind": "rollout", "environment": "ant", "policy": {"kind": "random"}},
                "parameters": {"num_steps": [1, 2]},
            },
            "/job/kind",
            "The method `pbt` trains, and a rollout does not; give a job that does.",
        ),
        (
            {"job": {**JOB, "resume_from": {"job": "019aa3c2f0b1-5be0c1d2e3"}}},
            "/job/resume_from",
            "With `pbt`, a trial resumes from its parent; leave `resume_from` out.",
        ),
        (
            {
                "job": {
                    "kind": "train",
                    "environment": "ant",
                    "algorithm": {"kind": "dqn", "num_timesteps": 1000},
                }
            },
            "/job/algorithm/kind",
            "The method `pbt` trains in parts, and what `dqn` does depends on the length of its run; take "
            "`ppo` or `sac`.",
        ),
        (
            {"job": {"kind": "train", "environment": "ant"}},
            "/job/algorithm/num_timesteps",
            "The method `pbt` divides the job's `num_timesteps` into generations; give it.",
        ),
        (
            {"parameters": {"algorithm.num_timesteps": [1000, 2000]}},
            "/parameters/algorithm.num_timesteps",
            "With `pbt`, every trial trains for one generation: leave this axis out.",
        ),
        (
            {"parameters": {"seed": [1, 2]}},
            "/parameters/seed",
            "With `pbt`, each member begins with the job's seed plus its number, and a run that resumes has "
            "its parent's random state: leave `seed` out.",
        ),
        (
            {"parameters": {"environment.options.healthy_reward": [0.5, 1.0]}},
            "/parameters/environment.options.healthy_reward",
            "`environment.options.healthy_reward` cannot change in a run that resumes, or changes nothing in "
            "its training: `pbt` varies settings of the algorithm alone.",
        ),
        (
            {"parameters": {"algorithm.num_envs": [64, 128], RATE: [1e-4, 1e-3]}},
            "/parameters/algorithm.num_envs",
            "`algorithm.num_envs` cannot change in a run that resumes from a checkpoint.",
        ),
        (
            {"parameters": {"algorithm.policy_hidden_layer_sizes": [[32], [64]]}},
            "/parameters/algorithm.policy_hidden_layer_sizes",
            None,
        ),
        (
            {"parameters": {"algorithm.unroll_length": [5, 10]}},
            "/parameters/algorithm.unroll_length",
            "`algorithm.unroll_length` cannot change in a run that resumes from a checkpoint, because "
            "`env_steps_per_update` follows from it.",
        ),
        (
            {"parameters": {"algorithm.reset_pool_size": [64, 128, 0]}},
            "/parameters/algorithm.reset_pool_size",
            "`algorithm.reset_pool_size` cannot change in a run that resumes from a checkpoint, because "
            "`returns_to_first_state` follows from it.",
        ),
        (
            {"job": of_algorithm(learning_rate_schedule="ADAPTIVE_KL")},
            f"/parameters/{RATE}",
            f"`{RATE}` is read only at a run's beginning, so `pbt` would change nothing with it.",
        ),
        (
            {
                "job": {
                    "kind": "train",
                    "environment": "ant",
                    "algorithm": {"kind": "sac", "num_timesteps": 10**6},
                },
                "parameters": {"algorithm.init_alpha": [0.1, 0.2]},
            },
            "/parameters/algorithm.init_alpha",
            "`algorithm.init_alpha` is read only at a run's beginning, so `pbt` would change nothing with "
            "it.",
        ),
        (
            {
                "job": {"kind": "train", "environment": "ant", "algorithm": {"num_timesteps": 10**8}},
                "parameters": {"algorithm.kind": ["ppo", "sac"]},
            },
            "/parameters/algorithm.kind",
            "`algorithm.kind` cannot change in a run that resumes from a checkpoint.",
        ),
        (
            {"parameters": {RATE: [1e-3, 3]}},
            f"/parameters/{RATE}",
            f"`{RATE}` = 3: must be less than or equal to 1.",
        ),
        (
            {"budget": {"steps": 5119}},
            "/budget/steps",
            "The budget of 5,119 steps allows no trial: one takes 5,120 steps.",
        ),
    ],
)
def test_a_population_that_cannot_work_is_refused_in_a_sentence(
    stack: Stack, changes: dict[str, Any], pointer: str, sentence: str | None
) -> None:
    refused = problem(stack.http.post("/sweeps", json={**SWEEP, **changes}), 422, "invalid-request")
    assert pointers(refused) == [pointer]
    if sentence is not None:
        assert refused["errors"][0]["detail"] == sentence


@pytest.mark.parametrize(
    "parameters",
    [
        {"algorithm.reset_pool_size": [64, 128]},
        {
            "algorithm.clipping_epsilon": {"low": 0.1, "high": 0.3},
            "algorithm.normalize_advantage": [True, False],
        },
        {"algorithm.num_updates_per_batch": {"low": 1, "high": 8}},
    ],
)
def test_what_may_change_is_accepted(stack: Stack, parameters: dict[str, Any]) -> None:
    answer = stack.http.post("/sweeps", json={**SWEEP, "parameters": parameters})
    assert answer.status_code == 202, answer.text
