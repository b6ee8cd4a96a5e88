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
from core.physics.choose import engine_builder

NUM_ENVS = 8
WALKERS = {"ant", "half_cheetah", "hopper", "walker2d", "humanoid", "rodent", "corridor"}
STARS = {"brittle_star", "brittle_star_undirected", "brittle_star_light_escape"}
# The other stars are the same body.
SLOW = {"brittle_star_undirected"}


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
    assert info.episode_length == environment.episode_length == (500 if info.id in STARS else 1000)
    assert info.tracked_body == model.body(environment.tracked_body).name
    names = [model.camera(index).name for index in range(model.ncam)]
    assert info.cameras == tuple(name for name in names if name)


def test_a_step_keeps_the_states_form(case: Case) -> None:
    before = fresh(case)
    after = case.step(before, some_actions(case))
    assert jax.tree.structure(before) == jax.tree.structure(after)
    for one, other in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype) == (one.shape, np.float32)
        assert np.isfinite(other).all()


def test_a_body_on_its_way_says_how_fast_it_goes(case: Case) -> None:
    state = case.step(fresh(case), some_actions(case))
    assert ("x_velocity" in state.metrics) == (case.info.id in WALKERS | STARS)


def test_of_a_body_that_travels_height_and_distance_are_measured(case: Case) -> None:
    state = case.step(fresh(case), some_actions(case))
    model, body = case.environment.model, case.environment.tracked_body
    found = jax.vmap(body_position(model, body))(state.physics)
    wanted = {"height", "distance_from_origin"} if case.info.id in WALKERS | STARS else set()
    if case.info.id == "inverted_pendulum":  # The cart stays level.
        wanted = {"distance_from_origin"}
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
    assert np.isnan(state.reward[0]) or case.info.id == "inverted_pendulum"


@pytest.mark.parametrize("environment_id", ["ant", "hopper", "walker2d", "humanoid", "rodent"])
def test_unhealthy_ends_the_episode_unless_told_otherwise(environment_id: str) -> None:
    heights = [0.01, 3.0]  # every torso begins at such a height, in metres
    ends = make(environment_id, healthy_z_range=heights, terminate_when_unhealthy=True)
    # One environment and nothing compiled: a step is all that is asked for.
    begin, action = ends.reset(jax.random.key(0)), jnp.zeros(ends.action_size)
    up = 1 if environment_id in ("hopper", "walker2d") else 2  # in a plane or in space
    lifted = begin.physics.qpos.at[up].add(10.0)
    begin = replace(begin, physics=replace(begin.physics, qpos=lifted))
    ended = ends.step(begin, action)
    goes_on = make(environment_id, healthy_z_range=heights, terminate_when_unhealthy=False)
    going = goes_on.step(begin, action)
    assert (float(ended.done), float(going.done)) == (1.0, 0.0)
    # Without the end there is no reward for being healthy either: 1 a step, but for two of them.
    healthy_reward = {"humanoid": 5.0, "rodent": 0.5}.get(environment_id, 1.0)
    assert float(ended.reward - going.reward) == pytest.approx(healthy_reward, rel=1e-5)


@pytest.mark.parametrize("environment_id", sorted(WALKERS - {"rodent", "corridor"}))
def test_hidden_positions_can_be_shown(environment_id: str) -> None:
    shown = make(environment_id, exclude_current_positions_from_observation=False)
    state = shown.reset(jax.random.key(0))
    hidden = 2 if environment_id in {"ant", "humanoid"} else 1
    by_default = catalog.find(environment_id).observation_size
    assert by_default is not None
    assert state.obs.shape == (shown.observation_size,) == (by_default + hidden,)
    np.testing.assert_array_equal(state.obs[:1], state.physics.qpos[:1])


def test_the_reset_noise_can_be_switched_off() -> None:
    physics = make("ant", reset_noise_scale=0.0).reset(jax.random.key(0)).physics
    # The file's init_qpos: 0.55 m up, standing.
    assert float(physics.qpos[2]) == pytest.approx(0.55)
    np.testing.assert_array_equal(physics.qvel, 0.0)
