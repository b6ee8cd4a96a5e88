import jax
import jax.numpy as jnp
import pytest

from core.environments.environment import State
from core.environments.wrappers.action_repeat import repeat_action
from core.physics.engine import OVERFLOW
from tests.overflowing import Overflowing
from tests.probes import Probe

# The observation is the time and so is the reward; a step from time 4 ends the episode.
WORLD = Probe(lambda obs, time, action: (time, jnp.where(time == 4, 1.0, 0.0)), shows_time=True)
ACTION = jnp.ones(1)


def seen(state: State) -> tuple[float, float, float]:
    """(time, reward, done)"""
    return float(state.obs[0]), float(state.reward), float(state.done)


def test_an_action_is_held_and_its_rewards_add_up() -> None:
    world = repeat_action(WORLD, 3)
    once = world.step(world.reset(jax.random.PRNGKey(0)), ACTION)
    assert seen(once) == (3.0, 0.0 + 1.0 + 2.0, 0.0)


def test_an_episode_that_ends_half_way_stands_still_from_there_on() -> None:
    world = repeat_action(WORLD, 3)
    state = world.step(world.reset(jax.random.PRNGKey(0)), ACTION)
    # From time 3: the steps from 3 and from 4 are taken, the second ends it, and the third is not.
    assert seen(world.step(state, ACTION)) == (5.0, 3.0 + 4.0, 1.0)


def test_metrics_are_means_over_the_steps_and_those_not_taken_add_nothing() -> None:
    # The velocity is the action, 1.
    world = repeat_action(WORLD, 3)
    state = world.step(world.reset(jax.random.PRNGKey(0)), ACTION)
    assert float(state.metrics["x_velocity"]) == pytest.approx(1.0)
    assert float(world.step(state, ACTION).metrics["x_velocity"]) == pytest.approx(2 / 3)


def test_contacts_that_any_of_the_steps_lost_are_told_of_the_action() -> None:
    world = repeat_action(Overflowing(WORLD), 3)
    once = world.step(world.reset(jax.random.PRNGKey(0)), ACTION)
    twice = world.step(once, ACTION)
    assert [float(state.physics.derived[OVERFLOW]) for state in (once, twice)] == [1.0, 0.0]


def test_the_end_of_an_episode_before_is_not_that_of_this_one() -> None:
    world = repeat_action(WORLD, 2)
    fresh = world.reset(jax.random.PRNGKey(0))
    after = world.step(State(**{**vars(fresh), "done": jnp.ones(())}), ACTION)
    assert seen(after) == (2.0, 0.0 + 1.0, 0.0)


def test_time_passes_faster_and_the_rest_stays() -> None:
    world = repeat_action(WORLD, 3)
    assert world.dt == pytest.approx(3.0)
    assert world.episode_length == 3  # eight steps: two actions and a part of a third
    assert (world.observation_size, world.action_size, world.tracked_body) == (1, 1, 0)
    assert world.model is WORLD.model
    assert repeat_action(WORLD, 1) is WORLD
