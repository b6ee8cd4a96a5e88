from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments.environment import TRUNCATED, State
from core.environments.wrappers.autoreset import (
    Episodes,
    begun_at_random,
    draw,
    follow,
    fresh_states,
    start_episodes,
)
from core.environments.wrappers.vectorized import VectorEnv
from tests.probes import Probe

# The observation is the time, the reward the action; an action above 0.9 terminates.
ENV = Probe(lambda obs, time, action: (action, jnp.where(action > 0.9, 1.0, 0.0)), shows_time=True)
ENVS = VectorEnv(ENV)


class Remembering(Probe):
    """Starts at a random number, which it shows and counts up from, in `info` too."""

    def reset(self, key: jax.Array) -> State:
        state = super().reset(key)
        start = jax.random.uniform(key)
        return State(state.physics, start[None], state.reward, state.done, {}, {"count": start})

    def step(self, state: State, action: jax.Array) -> State:
        count = state.info["count"] + 1
        return State(state.physics, count[None], action[0], jnp.zeros(()), {}, {"count": count})


REMEMBERINGS = VectorEnv(Remembering(ENV.rule))


def step_episodes(
    envs: VectorEnv,
    episodes: Episodes,
    action: jax.Array,
    starts: State | None = None,
    *,
    episode_length: int,
) -> Episodes:
    return follow(episodes, envs.step(episodes.state, action), starts, episode_length=episode_length)


def act(episodes: Episodes, *actions: float) -> Episodes:
    return step_episodes(ENVS, episodes, jnp.array(actions)[:, None], episode_length=3)


def test_an_episode_is_cut_off_by_length_or_terminates_and_starts_anew() -> None:
    episodes = start_episodes(ENVS, jax.random.PRNGKey(0), 2, keep_first=True)
    episodes = act(episodes, 0.25, 0.5)
    np.testing.assert_array_equal(episodes.state.done, [0, 0])
    np.testing.assert_array_equal(episodes.state.obs, [[1], [1]])

    # The second environment terminates with its second step: it is back at time 0, its reward and score are
    # kept.
    episodes = act(episodes, 0.25, 1.0)
    np.testing.assert_array_equal(episodes.state.done, [0, 1])
    np.testing.assert_array_equal(episodes.truncated, [0, 0])
    np.testing.assert_array_equal(episodes.state.obs, [[2], [0]])
    np.testing.assert_array_equal(episodes.state.physics.time, [2, 0])
    np.testing.assert_array_equal(episodes.state.reward, [0.25, 1.0])
    np.testing.assert_array_equal(episodes.ended_length, [0, 2])
    np.testing.assert_array_equal(episodes.ended_score, [0, 1.5])

    # The first environment is cut off with its third step; the second counts from its fresh start.
    episodes = act(episodes, 0.5, 0.25)
    np.testing.assert_array_equal(episodes.state.done, [1, 0])
    np.testing.assert_array_equal(episodes.truncated, [1, 0])
    np.testing.assert_array_equal(episodes.state.obs, [[0], [1]])
    np.testing.assert_array_equal(episodes.ended_length, [3, 0])
    np.testing.assert_array_equal(episodes.ended_score, [1.0, 0])
    np.testing.assert_array_equal(episodes.length, [0, 1])
    np.testing.assert_array_equal(episodes.score, [0, 0.25])


def test_episodes_that_began_at_random_end_one_after_the_other_from_the_first_on() -> None:
    aligned = start_episodes(ENVS, jax.random.PRNGKey(0), 3000, keep_first=True)
    episodes = begun_at_random(aligned, jax.random.PRNGKey(1), episode_length=3)
    jax.tree.map(np.testing.assert_array_equal, episodes.state, aligned.state)
    # A third of the environments in each length below 3: 1000 of 3000, with a deviation of 26.
    np.testing.assert_allclose(np.bincount(episodes.length), [1000] * 3, atol=130)
    # With length k they are cut off after 3 - k actions, and again every three.
    for action in range(1, 7):
        ends = (np.asarray(episodes.length) + 1) % 3 == 0
        episodes = act(episodes, *[0.5] * 3000)
        np.testing.assert_array_equal(episodes.truncated, ends)
        # What it scored is what it did: half for each of at most three actions.
        scored = min(action, 3) / 2
        assert float(jnp.max(episodes.ended_score)) == scored


def test_an_episode_that_terminates_with_its_last_step_is_not_truncated() -> None:
    episodes = start_episodes(ENVS, jax.random.PRNGKey(0), 1, keep_first=True)
    for action in (0.0, 0.0, 1.0):
        episodes = act(episodes, action)
    np.testing.assert_array_equal(episodes.state.done, [1])
    np.testing.assert_array_equal(episodes.truncated, [0])
    np.testing.assert_array_equal(episodes.ended_length, [3])


@pytest.mark.parametrize(("failed", "truncated"), [(0.0, 1.0), (1.0, 0.0)])
def test_an_episode_whose_task_is_over_is_truncated_unless_it_failed(failed: float, truncated: float) -> None:
    episodes = start_episodes(ENVS, jax.random.PRNGKey(0), 1, keep_first=True)
    over = {TRUNCATED: jnp.array([1.0 - failed])}
    assert episodes.first is not None
    first = replace(episodes.first, info={TRUNCATED: jnp.zeros(1)})
    ended = replace(episodes.state, done=jnp.ones(1), info=over)
    after = follow(replace(episodes, first=first), ended, None, episode_length=3)
    np.testing.assert_array_equal(after.truncated, [truncated])
    np.testing.assert_array_equal(after.state.done, [1])
    np.testing.assert_array_equal(after.ended_length, [1])
    np.testing.assert_array_equal(after.state.info[TRUNCATED], [0])


def test_each_environment_goes_back_to_its_own_first_state_and_info_where_that_was_kept() -> None:
    first = start_episodes(REMEMBERINGS, jax.random.PRNGKey(0), 2, keep_first=True)
    assert first.state.obs[0] != first.state.obs[1]
    once = step_episodes(REMEMBERINGS, first, jnp.zeros((2, 1)), episode_length=2)
    np.testing.assert_array_equal(once.state.obs, first.state.obs + 1)
    twice = step_episodes(REMEMBERINGS, once, jnp.zeros((2, 1)), episode_length=2)
    np.testing.assert_array_equal(twice.state.obs, first.state.obs)
    np.testing.assert_array_equal(twice.state.info["count"], first.state.info["count"])


def test_an_environment_whose_episode_ends_starts_anew_from_what_was_drawn_for_it() -> None:
    episodes = start_episodes(REMEMBERINGS, jax.random.PRNGKey(0), 3)
    pool = fresh_states(REMEMBERINGS, jax.random.PRNGKey(1), 2)
    assert len(np.unique(pool.obs)) == 2
    starts = draw(pool, jnp.array([1, 0, 1]))
    once = step_episodes(REMEMBERINGS, episodes, jnp.zeros((3, 1)), starts, episode_length=2)
    np.testing.assert_array_equal(once.state.obs, episodes.state.obs + 1)
    twice = step_episodes(REMEMBERINGS, once, jnp.zeros((3, 1)), starts, episode_length=2)
    np.testing.assert_array_equal(twice.state.obs, pool.obs[np.array([1, 0, 1])])
    np.testing.assert_array_equal(twice.state.info["count"], pool.info["count"][np.array([1, 0, 1])])
    np.testing.assert_array_equal(twice.ended_length, [2, 2, 2])


def test_without_a_start_to_go_to_it_is_a_mistake() -> None:
    episodes = start_episodes(ENVS, jax.random.PRNGKey(0), 1)
    with pytest.raises(ValueError, match="no states to restart from"):
        step_episodes(ENVS, episodes, jnp.zeros((1, 1)), episode_length=3)
