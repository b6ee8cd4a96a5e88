"""A body whose state is lost stands where it was, and its episode ends."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from core.environments.environment import State
from core.environments.wrappers.autoreset import without_lost
from core.physics.engine import PhysicsState


def states(qpos: list[float], *, obs: list[float], reward: list[float]) -> State:
    """One number of each for every body."""
    column = jnp.array(qpos)[:, None]
    physics = PhysicsState(column, column, column, column, jnp.array(qpos), {"xpos": column})
    zeros = jnp.zeros(len(qpos))
    seen = {"state": jnp.array(obs)[:, None], "picture": jnp.ones((len(qpos), 2, 2))}
    return State(physics, seen, jnp.array(reward), zeros, {"speed": jnp.array(qpos)}, {"goal": column})


def test_only_the_lost_ones_stand_where_they_were() -> None:
    nan = float("nan")
    before = states([1.0, 2.0, 3.0, 4.0], obs=[1.0, 2.0, 3.0, 4.0], reward=[9.0, 9.0, 9.0, 9.0])
    after = states([5.0, nan, 7.0, 8.0], obs=[5.0, 6.0, float("inf"), 8.0], reward=[1.0, 1.0, 1.0, nan])
    found, lost = without_lost(before, after)
    assert lost.tolist() == [False, True, True, False]
    assert found.physics.qpos[:, 0].tolist() == [5.0, 2.0, 3.0, 8.0]
    assert found.physics.derived["xpos"][:, 0].tolist() == [5.0, 2.0, 3.0, 8.0]
    assert found.obs["state"][:, 0].tolist() == [5.0, 2.0, 3.0, 8.0]
    assert found.info["goal"][:, 0].tolist() == [5.0, 2.0, 3.0, 8.0]
    assert found.done.tolist() == [0.0, 1.0, 1.0, 0.0]
    assert found.metrics["speed"].tolist() == [5.0, 0.0, 0.0, 8.0]
    # The last one's reward is the task's own error.
    np.testing.assert_array_equal(found.reward, [1.0, 0.0, 0.0, nan])


def test_a_state_that_is_finite_stays_as_it_is() -> None:
    before = states([1.0, 2.0], obs=[1.0, 2.0], reward=[0.0, 0.0])
    after = replace(before, done=jnp.array([0.0, 1.0]))
    found, lost = without_lost(before, after)
    assert not lost.any()
    jax.tree.map(np.testing.assert_array_equal, found, after)
