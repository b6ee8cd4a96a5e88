"""Population-based training with a real worker: a loser's run continues from the winner's checkpoint."""

import pytest

from gaitway.client import Client

METRIC = "eval/episode_reward"
RATE = "algorithm.learning_rate"
# Updates of 640 steps: eight in each generation.
ALGORITHM = {
    "num_timesteps": 10_240,
    "num_envs": 64,
    "unroll_length": 10,
    "batch_size": 16,
    "num_minibatches": 4,
    "num_evals": 4,
    "num_eval_envs": 4,
    "episode_length": 100,
    "policy_hidden_layer_sizes": [16],
    "value_hidden_layer_sizes": [16],
}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_loser_resumes_from_the_winners_checkpoint_with_other_settings(client: Client) -> None:
    sweep = client.sweep(
        job={
            "kind": "train",
            "environment": "inverted_pendulum",
            "algorithm": ALGORITHM,
            "video": None,
            "seed": 3,
        },
        method="pbt",
        parameters={RATE: {"low": 1e-5, "high": 1e-2, "log": True}},
        population={"size": 2, "generations": 2, "resample_probability": 0.0},
        budget={"parallel": 1},
    )
    done = client.wait_for_sweep(sweep.id, timeout=500)
    assert (done.status, done.message) == ("succeeded", "Every generation was trained: 4 succeeded.")
    first, second = done.trials[:2], done.trials[2:]
    won = max(first, key=lambda trial: trial.values[0] or 0.0)
    assert [trial.parent for trial in second] == [won.number, won.number]
    loser = second[1 - won.number]
    factor = loser.parameters[RATE] / won.parameters[RATE]
    assert min(abs(factor - one) for one in (0.8, 1.2)) < 1e-9 or loser.parameters[RATE] in (1e-5, 1e-2)
    assert second[won.number].parameters == won.parameters
    assert [trial.step for trial in done.trials] == 4 * [5120]

    assert won.job is not None
    assert loser.job is not None
    job = client.get(loser.job)
    assert job.spec["resume_from"]["job"] == won.job
    assert [attempt.details["resumed_at_step"] for attempt in job.attempts] == [5120]
    # What the job does not say is as in the parent's run, also where other values are tuned.
    assert "clipping_epsilon" in job.spec["algorithm"]
    # Its curve begins where the winner's ends.
    steps = [event.data["step"] for event in client.events(loser.job) if event.kind == "metrics"]
    assert min(steps) > 5120
    assert max(steps) == 10_240
