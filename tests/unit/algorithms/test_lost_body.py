"""The last states of the first body that an update lost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.lost_body import MOST_STATES, LostBody, Steps, earlier, first_lost

NUM_ENVS = 3


def steps(num_steps: int, ended: list[tuple[int, int]]) -> Steps:
    """Positions tell the environment and the time step. ended: (time step, environment) of episodes' ends."""
    at = jnp.arange(num_steps, dtype=jnp.float32)[:, None] + 10_000 * jnp.arange(NUM_ENVS)
    ends = np.zeros((num_steps, NUM_ENVS), np.float32)
    for place in ended:
        ends[place] = 1
    return Steps(jnp.stack([at, -at, 2 * at, at + 0.5, jnp.array(ends)], axis=-1), (1, 1, 1, 0))


def lost_at(num_steps: int, places: list[tuple[int, int]], ended: list[tuple[int, int]]) -> LostBody:
    lost = np.zeros((num_steps, NUM_ENVS), np.float32)
    for place in places:
        lost[place] = 1
    return jax.device_get(jax.jit(first_lost)(steps(num_steps, ended), jnp.array(lost)))


@pytest.mark.parametrize(
    ("num_steps", "place", "ended", "first"),
    [
        (6, (4, 1), [], 0),
        (6, (0, 2), [], 0),
        (6, (5, 0), [(1, 0), (3, 1), (5, 0)], 2),  # An episode of its own began after step 1.
        (300, (299, 1), [], 300 - MOST_STATES),
        (300, (250, 1), [(245, 1)], 246),
        (300, (30, 1), [], 0),
    ],
)
def test_the_states_are_those_of_the_body_since_its_episode_began(
    num_steps: int, place: tuple[int, int], ended: list[tuple[int, int]], first: int
) -> None:
    time_step, env = place
    # Bodies that are lost later, and of a higher number at the same time, do not matter.
    later = [(time_step, other) for other in range(env + 1, NUM_ENVS)]
    lost = lost_at(num_steps, [place, *later, (num_steps - 1, 2)], [*ended, place])
    assert (bool(lost.found), int(lost.time_step), int(lost.env)) == (True, time_step, env)
    own = lost.of_the_episode()
    expected = 10_000 * env + np.arange(first, time_step + 1, dtype=np.float32)
    np.testing.assert_array_equal(own.qpos[:, 0], expected)
    np.testing.assert_array_equal(own.qvel[:, 0], -expected)
    np.testing.assert_array_equal(own.action[:, 0], 2 * expected)
    np.testing.assert_array_equal(own.reward, expected + 0.5)


def test_an_update_that_loses_none_finds_none() -> None:
    assert not lost_at(6, [], [(3, 1)]).found


def test_a_run_keeps_the_first_of_all() -> None:
    none, second, third = lost_at(6, [], []), lost_at(6, [(2, 1)], []), lost_at(6, [(0, 0)], [])
    kept = earlier(none, second, jnp.int32(7))
    assert kept is not None
    assert (bool(kept.found), int(kept.update), int(kept.env)) == (True, 7, 1)
    again = earlier(kept, third, jnp.int32(8))
    assert again is not None
    assert (int(again.update), int(again.env)) == (7, 1)
    assert earlier(None, None, jnp.int32(0)) is None
