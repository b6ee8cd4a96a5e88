"""MuJoCo Playground's environments are what its package makes of them."""

import json
from typing import Any

import jax
import numpy as np
import pytest

from core.algorithms.ppo.tuned import SETTINGS
from core.environments import catalog
from core.environments.environment import State
from core.environments.external.playground.environment import Playground, load
from core.environments.external.playground.info import TABLE
from core.errors import Rejected
from core.physics.availability import check_physics, choose
from core.physics.choose import engine_builder

NUM_ENVS = 3
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def episodes(environment: Any, actions: jax.Array) -> list[Any]:
    """The states [T, NUM_ENVS, ...] after each of the actions, from equal keys; and the first ones."""
    keys = jax.random.split(jax.random.PRNGKey(1), NUM_ENVS)

    @jax.jit
    def run(keys: jax.Array, actions: jax.Array) -> Any:
        def step(state: Any, action: jax.Array) -> tuple[Any, Any]:
            after = jax.vmap(environment.step)(state, action)
            return after, after

        first = jax.vmap(environment.reset)(keys)
        return first, jax.lax.scan(step, first, actions)[1]

    return list(run(keys, actions))


def assert_alike(ours: State, theirs: Any) -> None:
    """Rounding aside: without what is not carried, the compiler fuses other operations.

    Seen at the cheetah's velocities of up to 2.6 rad/s, which MJX's solver finds: 4e-5.
    """
    np.testing.assert_allclose(ours.obs, theirs.obs, rtol=1e-4, atol=1e-4)
    for name in ("reward", "done"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-5, atol=1e-5)
    assert ours.metrics.keys() == theirs.metrics.keys()
    for name, value in theirs.metrics.items():
        np.testing.assert_allclose(ours.metrics[name], value, rtol=1e-5, atol=1e-5, err_msg=name)
    np.testing.assert_array_equal(ours.info["rng"], theirs.info["rng"])
    np.testing.assert_allclose(ours.physics.qpos, theirs.data.qpos, atol=1e-5)


@pytest.mark.extra
def test_a_state_is_small_and_keeps_its_form_under_any_number_of_environments() -> None:
    pendulum = Playground("PendulumSwingup", "jax")
    keys = jax.random.split(jax.random.PRNGKey(0), NUM_ENVS)
    before = jax.eval_shape(jax.vmap(pendulum.reset), keys)
    after = jax.eval_shape(jax.vmap(pendulum.step), before, np.zeros((NUM_ENVS, 1), np.float32))
    assert jax.tree.map(lambda x: (x.shape, x.dtype), before) == jax.tree.map(
        lambda x: (x.shape, x.dtype), after
    )
    # qpos, qvel, qacc_warmstart, time; 3 observed; reward, done; a key of two numbers.
    assert sum(x.size for x in jax.tree.leaves(after)) == NUM_ENVS * (4 + 3 + 2 + 2)


@pytest.mark.slow  # two programs of MJX
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("name", "implementation"),
    [
        ("PendulumSwingup", "jax"),
        ("CartpoleBalance", "jax"),
        ("CheetahRun", "jax"),
        ("FishSwim", "jax"),
        ("CheetahRun", "warp"),
    ],
)
def test_equal_keys_and_actions_give_what_the_package_gives(name: str, implementation: Any) -> None:
    ours, theirs = Playground(name, implementation), load(name, implementation)
    shape = (5, NUM_ENVS, ours.action_size)
    actions = jax.random.uniform(jax.random.PRNGKey(2), shape, minval=-1.0, maxval=1.0)
    for one, other in zip(episodes(ours, actions), episodes(theirs, actions), strict=True):
        assert_alike(one, other)


@pytest.mark.slow  # it builds all of them
@pytest.mark.timeout(600)
def test_the_table_is_what_the_installed_package_says() -> None:
    from core.algorithms.ppo.describe_playground import settings
    from core.environments.external.playground.describe import table

    assert json.loads(TABLE.read_text()) == table()
    assert json.loads(SETTINGS.read_text()) == settings()


def test_they_run_on_mjx_wherever_c_mujoco_would_be_taken() -> None:
    info = catalog.find("playground/CheetahRun")
    assert choose("auto", "cpu", 256, info.on_a_cpu, info.cannot_run).name == "mjx"
    assert choose("auto", "gpu", 2048, info.on_a_gpu, info.cannot_run).name == "mjx"
    for engine in ("native", "compiled"):
        with pytest.raises(Rejected, match="step MJX themselves"):
            check_physics(engine, info.cannot_run)


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


@pytest.mark.slow  # it compiles two steps
def test_environments_may_differ_in_fields_of_the_model() -> None:
    pendulum: Any = Playground("PendulumSwingup", "jax")
    gravity = {"opt.gravity": np.zeros(3, np.float32)}
    state = pendulum.reset(jax.random.PRNGKey(0), gravity)
    after = jax.jit(pendulum.step)(state, np.zeros(1, np.float32))
    # Nothing pulls, nothing moves.
    np.testing.assert_allclose(after.physics.qpos, state.physics.qpos, atol=1e-6)
    falling = jax.jit(pendulum.step)(pendulum.reset(jax.random.PRNGKey(0)), np.zeros(1, np.float32))
    assert abs(float(falling.physics.qvel[0])) > 1e-3
