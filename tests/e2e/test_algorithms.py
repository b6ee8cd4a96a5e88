"""Jobs of the other algorithms go from POST to their video, as PPO's in test_pipeline.py."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.environments import trajectory
from gaitway.client import Client
from gaitway.errors import Rejected
from tests.e2e.test_pipeline import KEPT, SMALL, cancelled, rolled_out

OFF_POLICY: dict[str, Any] = {
    "num_timesteps": 6400,
    "num_envs": 32,
    "batch_size": 64,
    "min_replay_size": 256,
    "max_replay_size": 4096,
    "num_evals": 2,
    "num_eval_envs": 4,
    "episode_length": 100,
}
# Updates of 32 × 4 = 128 steps, which learn from the second on.
SMALL_SAC: dict[str, Any] = {
    **SMALL,
    "algorithm": {
        **OFF_POLICY,
        "kind": "sac",
        "unroll_length": 4,
        "policy_hidden_layer_sizes": [16],
        "q_hidden_layer_sizes": [16],
    },
    "checkpoints": {"every_steps": 1280},
}

# Updates of 32 environments and one action of two steps: 64 steps.
SMALL_DQN: dict[str, Any] = {
    **SMALL_SAC,
    "algorithm": {
        **OFF_POLICY,
        "kind": "dqn",
        "action_set": {"kind": "actions", "actions": [[-0.5], [0.0], [0.5]]},
        "action_repeat": 2,
        "hidden_layer_sizes": [16],
    },
}

# What of it only a policy of the usual form has.
FOR_ELSEWHERE = {"export", "simulation"}


@pytest.mark.slow  # DQN learns off-policy, too, below; PPO's policy in test_pipeline.py is of this form, too.
def test_sac_goes_the_same_way_as_ppo(quick_client: Client, tmp_path: Path) -> None:
    job = quick_client.wait(quick_client.submit(SMALL_SAC).id, timeout=110)
    assert job.succeeded, job.message
    assert (job.progress.step, job.progress.total) == (6400, 6400)
    assert {a.role for a in job.artifacts} == KEPT
    assert [a.step for a in quick_client.checkpoints(job.id)] == [1280 * i for i in range(1, 6)]
    names = {name for row in quick_client.metrics(job.id) for name in row.values}
    assert {"eval/episode_reward", "training/sps", "training/critic_loss", "training/alpha"} <= names
    final, kept = (quick_client.load_policy(job.id, step=step) for step in (None, 6400))
    seen = np.full(4, 0.1, np.float32)
    assert final(seen).shape == (1,)
    np.testing.assert_allclose(final(seen), kept(seen), rtol=1e-6)

    shown = rolled_out(quick_client, job, num_steps=20, num_episodes=2)
    assert shown.newest("video") is not None
    path = quick_client.download(shown.id, "trajectory.npz", tmp_path / "sac.npz")
    [episode, _] = trajectory.load(path).episodes
    assert len(np.unique(episode.action)) > 1


@pytest.mark.extra
def test_a_deep_q_network_goes_the_same_way(quick_client: Client, tmp_path: Path) -> None:
    job = quick_client.wait(quick_client.submit(SMALL_DQN).id, timeout=110)
    assert job.succeeded, job.message
    assert (job.progress.step, job.progress.total) == (6400, 6400)
    assert {a.role for a in job.artifacts} == KEPT - FOR_ELSEWHERE
    assert [a.step for a in quick_client.checkpoints(job.id)] == [1280 * i for i in range(1, 6)]
    names = {name for row in quick_client.metrics(job.id) for name in row.values}
    assert {"eval/episode_reward", "training/sps", "training/epsilon", "training/q_value"} <= names
    final, kept = (quick_client.load_policy(job.id, step=step) for step in (None, 6400))
    seen = np.full(4, 0.1, np.float32)
    assert final(seen).shape == (1,)
    np.testing.assert_array_equal(final(seen), kept(seen))

    shown = rolled_out(quick_client, job, num_steps=20, num_episodes=2)
    assert shown.newest("video") is not None
    path = quick_client.download(shown.id, "trajectory.npz", tmp_path / "dqn.npz")
    [episode, _] = trajectory.load(path).episodes
    assert set(np.unique(episode.action)) <= {-0.5, 0.0, 0.5}
    np.testing.assert_array_equal(episode.action[0:-1:2], episode.action[1::2])


@pytest.mark.extra
def test_a_table_goes_the_same_way_as_a_network(quick_client: Client, tmp_path: Path) -> None:
    # Rounds of 8 environments, 25 decisions of 2 steps: 400 steps. Angle and its velocity are seen.
    components = [
        {"index": index, "range": [-bound, bound], "cells": 6} for index, bound in ((1, 0.2), (3, 2.0))
    ]
    algorithm = {
        "kind": "q_learning",
        "state_discretizer": {"kind": "observation_grid", "components": components},
        "action_set": {"kind": "actions", "actions": [[-0.5], [0.0], [0.5]]},
        "num_episodes": 80,
        "num_envs": 8,
        "decisions_per_episode": 25,
        "decision_steps": 2,
        "num_evals": 2,
    }
    job = quick_client.wait(
        quick_client.submit({**SMALL, "algorithm": algorithm, "checkpoints": {}}).id, timeout=110
    )
    assert job.succeeded, job.message
    assert (job.progress.step, job.progress.total) == (4000, 4000)
    assert job.progress.metrics["training/episodes"] == 80
    assert {a.role for a in job.artifacts} == KEPT - FOR_ELSEWHERE | {"tables"}
    with pytest.raises(Rejected, match=r"`tables.npz` of an ended job is that table"):
        quick_client.export_policy(job.id, "onnx", tmp_path)
    assert job.artifact("q_table.png") is not None
    assert job.attempts[0].details["hyperparameters"]["state_discretizer"]["kind"] == "observation_grid"
    assert len(quick_client.checkpoints(job.id)) == 5
    names = {name for row in quick_client.metrics(job.id) for name in row.values}
    assert {"eval/episode_reward", "training/epsilon", "training/td_error", "training/q_max"} <= names
    column = quick_client.load_policy(job.id)({"observation": np.zeros(4, np.float32)})
    assert column.shape == (1,)

    shown = rolled_out(quick_client, job, num_steps=20, num_episodes=2)
    path = quick_client.download(shown.id, "trajectory.npz", tmp_path / "table.npz")
    [episode, _] = trajectory.load(path).episodes
    assert set(np.unique(episode.action)) <= {-0.5, 0.0, 0.5}
    np.testing.assert_array_equal(episode.action[0:-1:2], episode.action[1::2])


# A run of any algorithm ends in the same way: the cancel of PPO's is looked at in every run of the tests.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("small", "kept"), [(SMALL_SAC, KEPT), (SMALL_DQN, KEPT - FOR_ELSEWHERE)], ids=["sac", "dqn"]
)
def test_a_cancel_keeps_the_checkpoint_the_policy_and_the_video(
    quick_client: Client, small: dict[str, Any], kept: set[str]
) -> None:
    # Before its first evaluation.
    assert cancelled(quick_client, small) == kept - {"best_policy"}
