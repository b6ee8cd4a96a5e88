"""Every body of the catalog: what its row says is what it is, and what it does."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.body_position import body_position
from core.environments.environment import Environment, State
from core.environments.info import EnvironmentInfo
from core.environments.mujoco_env import MujocoEnv
from core.physics.choose import engine_builder
from tests.extra import extra

NUM_ENVS = 8
# The other stars are the same body.
SLOW = {"brittle_star_undirected"}
# By the folder of core/environments: the stars' 20 s are 500 actions of 0.04 s.
EPISODE_LENGTHS = {"page_env": 1000, "dm_control": 1000, "brittle_star": 500}


@dataclass(frozen=True)
class Case:
    info: EnvironmentInfo
    environment: Environment
    reset: Callable[[jax.Array], State]
    step: Callable[[State, jax.Array], State]


def make(environment_id: str, **options: object) -> Environment:
    info = catalog.find(environment_id)
    return catalog.make(info, catalog.parse_options(info, options), engine_builder("native"))


def build(environment_id: str) -> Case:
    info, environment = catalog.find(environment_id), make(environment_id)
    return Case(info, environment, jax.jit(jax.vmap(environment.reset)), jax.jit(jax.vmap(environment.step)))


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])
        for name, info in catalog.BUILT_IN.items()
        if not info.takes_model
    ],
)
def case(request: pytest.FixtureRequest) -> Case:
    return build(request.param)


def having(*options: str) -> list[str]:
    """The environments that have all of these options."""
    return [name for name, info in catalog.BUILT_IN.items() if info.options.model_fields.keys() >= {*options}]


def root_joints(environment: Environment) -> list[int]:
    """The types of the joints between the world and the tracked body's root."""
    model = environment.model
    root = int(model.body_rootid[environment.tracked_body])
    first = int(model.body_jntadr[root])
    return model.jnt_type[first : first + int(model.body_jntnum[root])].tolist()


def is_free(environment: Environment) -> bool:
    return mujoco.mjtJoint.mjJNT_FREE in root_joints(environment)


def travels(environment: Environment) -> bool:
    """Whether the body goes forward and rises: in space, or along two axes of a plane."""
    return is_free(environment) or root_joints(environment).count(mujoco.mjtJoint.mjJNT_SLIDE) > 1


def fresh(case: Case, seed: int = 0) -> State:
    return case.reset(jax.random.split(jax.random.key(seed), NUM_ENVS))


def some_actions(case: Case, seed: int = 1) -> jax.Array:
    shape = (NUM_ENVS, case.environment.action_size)
    return jax.random.uniform(jax.random.key(seed), shape, minval=-1.0, maxval=1.0)


def test_the_catalogs_row_is_true(case: Case) -> None:
    info, environment = case.info, case.environment
    model = environment.model
    assert info.observation_size == environment.observation_size == fresh(case).obs.shape[-1]
    assert info.action_size == environment.action_size == model.nu
    assert info.dt == pytest.approx(environment.dt)
    folder = info.factory.removeprefix("core.environments.").split(".")[0]
    expected = EPISODE_LENGTHS.get(folder, info.episode_length)
    assert info.episode_length == environment.episode_length == expected
    assert info.tracked_body == model.body(environment.tracked_body).name
    names = [model.camera(index).name for index in range(model.ncam)]
    assert info.cameras == tuple(name for name in names if name)


def test_an_episodes_observations_keep_the_bounds_that_the_row_gives(case: Case) -> None:
    state, bounded = (
        fresh(case),
        [one for one in case.info.spaces.observation if (one.low, one.high) != (None, None)],
    )
    for number in range(30):
        for one in bounded:
            values = np.asarray(state.obs[:, one.start : one.start + one.size])
            assert one.low is None or values.min() >= one.low - 1e-5, one.name
            assert one.high is None or values.max() <= one.high + 1e-5, one.name
        state = case.step(state, some_actions(case, number))


def test_a_step_keeps_the_states_form(case: Case) -> None:
    before = fresh(case)
    after = case.step(before, some_actions(case))
    assert jax.tree.structure(before) == jax.tree.structure(after)
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        assert one.dtype in (np.float32, np.int32, np.uint32)  # Counts of steps, and random keys.
        assert np.isfinite(other).all()


def test_a_body_on_its_way_says_how_fast_it_goes(case: Case) -> None:
    state = case.step(fresh(case), some_actions(case))
    assert ("x_velocity" in state.metrics) == travels(case.environment)


def test_the_reward_is_the_sum_of_its_terms_among_the_metrics(case: Case) -> None:
    environment = case.environment
    assert isinstance(environment, MujocoEnv)
    state = case.step(fresh(case), some_actions(case))
    named = {name for name in state.metrics if name.startswith("reward_") or name.endswith("_reward")}
    assert bool(named) == environment.reports_rewards
    for name, term in environment.aliases.items():
        np.testing.assert_array_equal(state.metrics[name], state.metrics[term])
    if named:
        terms = [state.metrics[name] for name in named - environment.aliases.keys()]
        np.testing.assert_allclose(state.reward, np.sum(terms, axis=0), rtol=1e-5, atol=1e-5)


def test_of_a_body_that_travels_height_and_distance_are_measured(case: Case) -> None:
    state = case.step(fresh(case), some_actions(case))
    model, body = case.environment.model, case.environment.tracked_body
    found = jax.vmap(body_position(model, body))(state.physics)
    moves = is_free(case.environment) or mujoco.mjtJoint.mjJNT_SLIDE in root_joints(case.environment)
    wanted = {"distance_from_origin"} if moves else set()
    if travels(case.environment):  # A cart on one rail stays level.
        wanted |= {"height"}
    assert wanted <= {*found, *state.metrics}
    data = mujoco.MjData(model)
    data.qpos[:] = state.physics.qpos[0]
    mujoco.mj_kinematics(model, data)
    position = data.xpos[body]
    expected = {"height": position[2], "distance_from_origin": np.linalg.norm(position)}
    for name, values in found.items():
        assert float(values[0]) == pytest.approx(expected[name], abs=1e-5)


def test_initial_states_differ_by_key_and_by_nothing_else(case: Case) -> None:
    once, again, other = fresh(case), fresh(case), fresh(case, seed=5)
    np.testing.assert_array_equal(once.obs, again.obs)
    assert not np.array_equal(once.obs, other.obs)
    assert len(np.unique(np.asarray(once.obs), axis=0)) == NUM_ENVS


def test_an_environment_that_breaks_does_not_look_well(case: Case) -> None:
    state = case.step(fresh(case), some_actions(case).at[0].set(jnp.nan))
    assert not np.isfinite(state.obs[0]).all()
    assert np.isfinite(state.obs[1:]).all()
    # A constant reward aside, the reward says so too, so that ending the episode cannot hide it.
    is_constant = len(np.unique(np.asarray(state.reward[1:]))) == 1
    assert np.isnan(state.reward[0]) or is_constant


@pytest.mark.parametrize(
    "environment_id", ["ant", *extra(*having("terminate_when_unhealthy", "healthy_z_range"))]
)
def test_unhealthy_ends_the_episode_unless_told_otherwise(environment_id: str) -> None:
    heights = [0.01, 3.0]  # every torso begins at such a height, in metres
    ends = make(environment_id, healthy_z_range=heights, terminate_when_unhealthy=True)
    # One environment and nothing compiled: a step is all that is asked for.
    begin, action = ends.reset(jax.random.key(0)), jnp.zeros(ends.action_size)
    up = 2 if is_free(ends) else 1  # in space or in a plane
    lifted = begin.physics.qpos.at[up].add(10.0)
    begin = replace(begin, physics=replace(begin.physics, qpos=lifted))
    ended = ends.step(begin, action)
    goes_on = make(environment_id, healthy_z_range=heights, terminate_when_unhealthy=False)
    going = goes_on.step(begin, action)
    assert (float(ended.done), float(going.done)) == (1.0, 0.0)
    # Without the end there is no reward for being healthy either.
    healthy_reward = catalog.find(environment_id).options.model_fields["healthy_reward"].default
    assert float(ended.reward - going.reward) == pytest.approx(healthy_reward, rel=1e-5)


@pytest.mark.parametrize("environment_id", having("exclude_current_positions_from_observation"))
def test_hidden_positions_can_be_shown(environment_id: str) -> None:
    shown = make(environment_id, exclude_current_positions_from_observation=False)
    hiding = make(environment_id, exclude_current_positions_from_observation=True)
    state = shown.reset(jax.random.key(0))
    hidden = 2 if is_free(shown) else 1
    assert isinstance(hiding.observation_size, int)
    assert state.obs.shape == (shown.observation_size,) == (hiding.observation_size + hidden,)
    np.testing.assert_array_equal(state.obs[:1], state.physics.qpos[:1])


def test_the_reset_noise_can_be_switched_off() -> None:
    physics = make("ant", reset_noise_scale=0.0).reset(jax.random.key(0)).physics
    # The file's init_qpos: 0.55 m up, standing.
    assert float(physics.qpos[2]) == pytest.approx(0.55)
    np.testing.assert_array_equal(physics.qvel, 0.0)
