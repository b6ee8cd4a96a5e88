from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.evaluation import EpisodeTotals, evaluation_metrics, run_episodes
from core.environments.probes import Probe


def half(observation: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
    return jnp.full_like(observation, 0.5), {}


def test_an_episode_counts_until_it_ends_and_no_further() -> None:
    # A world whose observation is its sign: +1 ends with the third step (time 2), -1 never does.
    world = Probe(
        lambda obs, time, action: (action, jnp.where((obs > 0) & (time >= 2), 1.0, 0.0)), random_sign=True
    )
    totals = run_episodes(world, half, jax.random.PRNGKey(0), num_envs=8, episode_length=5)
    np.testing.assert_array_equal(np.unique(totals.length), [3, 5])
    np.testing.assert_allclose(totals.metrics["reward"], 0.5 * totals.length)
    np.testing.assert_allclose(totals.metrics["x_velocity"], 0.5 * totals.length)


def test_it_stops_when_the_last_episode_has_ended() -> None:
    steps = list[int]()
    world = Probe(lambda obs, time, action: (action, jnp.ones(())))

    def counting(observation: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
        jax.debug.callback(lambda: steps.append(1))
        return half(observation, key)

    totals = run_episodes(world, counting, jax.random.PRNGKey(0), num_envs=2, episode_length=10**6)
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
