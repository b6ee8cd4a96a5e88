from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from tests.probes import Probe


def half(observation: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
    return jnp.full_like(observation, 0.5), {}


def test_an_episode_counts_until_it_ends_and_no_further() -> None:
    # An environment whose observation is its sign: +1 ends with the third step (time 2), -1 never does.
    env = Probe(
        lambda obs, time, action: (action, jnp.where((obs > 0) & (time >= 2), 1.0, 0.0)), random_sign=True
    )
    totals = run_episodes(env, half, jax.random.PRNGKey(0), num_envs=8, episode_length=5)
    np.testing.assert_array_equal(np.unique(totals.length), [3, 5])
    np.testing.assert_allclose(totals.metrics["reward"], 0.5 * totals.length)
    np.testing.assert_allclose(totals.metrics["x_velocity"], 0.5 * totals.length)


def test_it_stops_when_the_last_episode_has_ended() -> None:
    steps = list[int]()
    env = Probe(lambda obs, time, action: (action, jnp.ones(())))

    def counting(observation: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
        jax.debug.callback(lambda: steps.append(1))
        return half(observation, key)

    totals = run_episodes(env, counting, jax.random.PRNGKey(0), num_envs=2, episode_length=10**6)
    jax.effects_barrier()
    np.testing.assert_array_equal(totals.length, [1, 1])
    assert len(steps) == 1


def test_metrics_are_means_over_episodes_and_the_speed_is_one_over_steps() -> None:
    totals = EpisodeTotals(
        metrics={"reward": np.array([1.0, 3.0]), "x_velocity": np.array([2.0, 7.0])},
        length=np.array([1.0, 2.0]),
    )
    assert evaluation_metrics(totals) == {
        "eval/episode_reward": 2.0,
        "eval/episode_x_velocity": 4.5,
        "eval/episode_reward_std": 1.0,
        "eval/avg_episode_length": 1.5,
        # Nine metres per second over three steps.
        "eval/forward_speed": pytest.approx(3.0),
    }


def test_what_an_action_is_the_mean_of_counts_once_for_each_of_its_steps() -> None:
    # Two actions of four steps; it fell in one of the eight.
    totals = EpisodeTotals(
        metrics={"reward": np.float32([8.0]), "x_velocity": np.float32([3.0]), "fell": np.float32([0.25])},
        length=np.float32([2.0]),
    )
    metrics = evaluation_metrics(totals, action_repeat=4)
    assert metrics["eval/episode_reward"] == 8.0
    assert metrics["eval/episode_fell"] == 1.0
    assert metrics["eval/episode_x_velocity"] == 12.0
    assert metrics["eval/avg_episode_length"] == 8.0
    assert metrics["eval/forward_speed"] == 1.5
