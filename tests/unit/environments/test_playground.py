"""MuJoCo Playground's environments are what its package makes of them."""

import json
from typing import Any

import jax
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import State
from core.environments.playground.environment import Playground, load
from core.environments.playground.info import TABLE
from core.errors import Rejected
from core.physics.availability import check_physics, choose
from core.physics.choose import engine_builder

NUM_WORLDS = 3
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def side_by_side(environment: Any) -> tuple[Any, Any]:
    return jax.jit(jax.vmap(environment.reset)), jax.jit(jax.vmap(environment.step))


def assert_alike(ours: State, theirs: Any) -> None:
    """Rounding aside: without what is not carried, the compiler fuses other operations."""
    for name in ("obs", "reward", "done"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-5, atol=1e-5)
    assert ours.metrics.keys() == theirs.metrics.keys()
    for name, value in theirs.metrics.items():
        np.testing.assert_allclose(ours.metrics[name], value, rtol=1e-5, atol=1e-5, err_msg=name)
    np.testing.assert_array_equal(ours.info["rng"], theirs.info["rng"])
    np.testing.assert_allclose(ours.physics.qpos, theirs.data.qpos, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "implementation"),
    [
        ("PendulumSwingup", "jax"),
        *(
            pytest.param(name, implementation, marks=[pytest.mark.slow, pytest.mark.timeout(600)])
            for name, implementation in (
                ("CartpoleBalance", "jax"),
                ("CheetahRun", "jax"),
                ("FishSwim", "jax"),
                ("CheetahRun", "warp"),
            )
        ),
    ],
)
def test_equal_keys_and_actions_give_what_the_package_gives(name: str, implementation: Any) -> None:
    ours, theirs = Playground(name, implementation), load(name, implementation)
    (reset, step), (their_reset, their_step) = side_by_side(ours), side_by_side(theirs)
    keys = jax.random.split(jax.random.PRNGKey(1), NUM_WORLDS)
    state, their_state = reset(keys), their_reset(keys)
    assert_alike(state, their_state)
    for number in range(5):
        shape = (NUM_WORLDS, ours.action_size)
        action = jax.random.uniform(jax.random.PRNGKey(number), shape, minval=-1.0, maxval=1.0)
        before, state = state, step(state, action)
        their_state = their_step(their_state, action)
        assert_alike(state, their_state)
        assert jax.tree.structure(before) == jax.tree.structure(state)
        for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(state), strict=True):
            assert (one.shape, one.dtype) == (other.shape, other.dtype)


@pytest.mark.slow  # it builds all of them
@pytest.mark.timeout(600)
def test_the_table_is_what_the_installed_package_says() -> None:
    from core.environments.playground.describe import table

    assert json.loads(TABLE.read_text()) == table()


def test_they_run_on_mjx_wherever_c_mujoco_would_be_taken() -> None:
    info = catalog.find("playground/CheetahRun")
    assert choose("auto", "cpu", info.id, 256, info.cannot_run).name == "mjx"
    assert choose("auto", "gpu", info.id, 2048, info.cannot_run).name == "mjx"
    with pytest.raises(Rejected, match="step MJX by themselves"):
        check_physics("native", info.id, info.cannot_run)


@pytest.mark.slow  # it compiles a reset with contacts
@pytest.mark.timeout(600)
def test_a_target_is_drawn_where_the_episode_has_it() -> None:
    info = catalog.find("playground/FishSwim")
    fish: Any = catalog.make(info, info.options(), engine_builder("mjx"))
    state = jax.jit(fish.reset)(jax.random.key(0))
    target = state.info["target_position"]
    np.testing.assert_array_equal(target, state.physics.derived["mocap_pos"][0])
    assert np.abs(target[:2]).max() <= 0.4
    assert 0.1 <= target[2] <= 0.3
    assert fish.model.body("target").mocapid[0] == -1


def test_worlds_may_differ_in_fields_of_the_model() -> None:
    pendulum: Any = Playground("PendulumSwingup", "jax")
    gravity = {"opt.gravity": np.zeros(3, np.float32)}
    state = pendulum.reset(jax.random.PRNGKey(0), gravity)
    after = jax.jit(pendulum.step)(state, np.zeros(1, np.float32))
    # Nothing pulls, nothing moves.
    np.testing.assert_allclose(after.physics.qpos, state.physics.qpos, atol=1e-6)
    falling = jax.jit(pendulum.step)(pendulum.reset(jax.random.PRNGKey(0)), np.zeros(1, np.float32))
    assert abs(float(falling.physics.qvel[0])) > 1e-3
