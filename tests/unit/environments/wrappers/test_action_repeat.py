import jax
import jax.numpy as jnp
import pytest

from core.environments.environment import State
from core.environments.wrappers.action_repeat import repeat_action
from core.physics.engine import OVERFLOW
from tests.overflowing import Overflowing
from tests.probes import Probe

# The observation is the time and so is the reward; a step from time 4 ends the episode.
ENV = Probe(lambda obs, time, action: (time, jnp.where(time == 4, 1.0, 0.0)), shows_time=True)
ACTION = jnp.ones(1)


def seen(state: State) -> tuple[float, float, float]:
    """(time, reward, done)"""
    return float(state.obs[0]), float(state.reward), float(state.done)


def test_an_action_is_held_and_its_rewards_add_up() -> None:
    env = repeat_action(ENV, 3)
    once = env.step(env.reset(jax.random.PRNGKey(0)), ACTION)
    assert seen(once) == (3.0, 0.0 + 1.0 + 2.0, 0.0)


def test_an_episode_that_ends_half_way_stands_still_from_there_on() -> None:
    env = repeat_action(ENV, 3)
    state = env.step(env.reset(jax.random.PRNGKey(0)), ACTION)
    # From time 3: the steps from 3 and from 4 are taken, the second ends it, and the third is not.
    assert seen(env.step(state, ACTION)) == (5.0, 3.0 + 4.0, 1.0)


def test_metrics_are_means_over_the_steps_and_those_not_taken_add_nothing() -> None:
    # The velocity is the action, 1.
    env = repeat_action(ENV, 3)
    state = env.step(env.reset(jax.random.PRNGKey(0)), ACTION)
    assert float(state.metrics["x_velocity"]) == pytest.approx(1.0)
    assert float(env.step(state, ACTION).metrics["x_velocity"]) == pytest.approx(2 / 3)


def test_contacts_that_any_of_the_steps_lost_are_told_of_the_action() -> None:
    env = repeat_action(Overflowing(ENV), 3)
    once = env.step(env.reset(jax.random.PRNGKey(0)), ACTION)
    twice = env.step(once, ACTION)
    assert [float(state.physics.derived[OVERFLOW]) for state in (once, twice)] == [1.0, 0.0]


def test_the_end_of_an_episode_before_is_not_that_of_this_one() -> None:
    env = repeat_action(ENV, 2)
    fresh = env.reset(jax.random.PRNGKey(0))
    after = env.step(State(**{**vars(fresh), "done": jnp.ones(())}), ACTION)
    assert seen(after) == (2.0, 0.0 + 1.0, 0.0)


def test_time_passes_faster_and_the_rest_stays() -> None:
    env = repeat_action(ENV, 3)
    assert env.dt == pytest.approx(3.0)
    assert env.episode_length == 3  # eight steps: two actions and a part of a third
    assert (env.observation_size, env.action_size, env.tracked_body) == (1, 1, 0)
    assert env.model is ENV.model
    assert repeat_action(ENV, 1) is ENV
