"""Samples of several steps; numbers by hand."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.off_policy.replay import Replay, ReplayRows, Sample, added, empty, sample

DISCOUNTING = 0.5


def rows(*, first: int, ended: list[float], truncated: list[float] | None = None) -> ReplayRows:
    """One environment's: the observation counts the rows, the reward is ten times that."""
    count = first + jnp.arange(len(ended), dtype=jnp.float32)
    cut = [0.0] * len(ended) if truncated is None else truncated
    return ReplayRows(
        observation=count[:, None, None],
        action=-count[:, None, None],
        reward=10 * count[:, None],
        ended=jnp.array(ended)[:, None],
        truncated=jnp.array(cut)[:, None],
    )


def replay_of(kept: ReplayRows, capacity: int) -> Replay:
    return added(empty(capacity, 1, 1, 1), kept)


def samples(replay: Replay, n_step: int) -> dict[float, Any]:
    """The sample that begins at each observation, of as many draws as find all."""
    drawn = sample(replay, jax.random.key(0), 500, n_step=n_step, discounting=jnp.float32(DISCOUNTING))
    by_start = dict[float, Any]()
    for place in range(500):
        one = Sample(*(np.asarray(x)[place] for x in drawn))
        by_start[float(one.observation[0])] = one
    return by_start


def test_rewards_are_added_up_and_the_rest_is_estimated_after_them() -> None:
    found = samples(replay_of(rows(first=1, ended=[0.0] * 5), 8), n_step=2)
    # The last two rows have no row two steps later.
    assert sorted(found) == [1.0, 2.0, 3.0]
    one = found[2.0]
    assert one.action == -2.0
    assert one.reward == 20 + 0.5 * 30
    assert one.discount == 0.25
    assert one.next_observation == 4.0
    assert one.weight == 1.0


def test_nothing_follows_an_end() -> None:
    found = samples(replay_of(rows(first=1, ended=[0.0, 1.0, 0.0, 0.0, 0.0]), 8), n_step=3)
    assert found[1.0].reward == 10 + 0.5 * 20
    assert found[1.0].discount == 0.0
    assert found[2.0].reward == 20
    assert found[2.0].discount == 0.0


def test_a_cut_is_left_out_and_what_follows_it_is_estimated() -> None:
    """The state after a cut is gone: the next row's observation is another episode's."""
    truncated = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    found = samples(replay_of(rows(first=1, ended=[0.0] * 6, truncated=truncated), 8), n_step=3)
    assert found[1.0].reward == 10 + 0.5 * 20
    assert found[1.0].discount == 0.25
    assert found[1.0].next_observation == 3.0
    assert found[2.0].reward == 20
    assert found[2.0].discount == 0.5
    assert found[2.0].next_observation == 3.0
    # Nothing is left of a step that is itself cut off.
    assert found[3.0].weight == 0.0


def test_the_oldest_rows_are_overwritten() -> None:
    replay = replay_of(rows(first=1, ended=[0.0] * 4), 4)
    replay = added(replay, rows(first=5, ended=[0.0] * 2))
    assert int(replay.written) == 6
    found = samples(replay, n_step=1)
    assert sorted(found) == [3.0, 4.0, 5.0]
    assert found[4.0].next_observation == 5.0
    assert found[5.0].next_observation == 6.0


@pytest.mark.parametrize("num_envs", [1, 3])
def test_every_environment_is_drawn(num_envs: int) -> None:
    replay = empty(4, num_envs, 1, 1)
    ones = jnp.ones((4, num_envs))
    number = jnp.broadcast_to(jnp.arange(num_envs, dtype=jnp.float32), (4, num_envs))
    replay = added(replay, ReplayRows(number[..., None], number[..., None], number, 0 * ones, 0 * ones))
    drawn = sample(replay, jax.random.key(1), 200, n_step=1, discounting=jnp.float32(1.0))
    assert set(np.unique(drawn.observation)) == set(range(num_envs))
    np.testing.assert_array_equal(drawn.reward, drawn.observation[:, 0])
    np.testing.assert_array_equal(drawn.next_observation, drawn.observation)
