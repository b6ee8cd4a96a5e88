"""Rollouts of small known environments, and of the ant with the native engine."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import Environment, State, Wrapped
from core.environments.rollout import (
    Roller,
    action_keys,
    constant_policy,
    cut,
    filmed,
    footage,
    initial_positions,
    random_policy,
    rollout,
    trajectory_of,
    zero_policy,
)
from core.environments.trajectory import Episode, not_finite
from core.physics.choose import engine_builder
from core.physics.engine import NOMINAL, ModelFields
from tests import probes

KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def ant() -> Environment:
    info = catalog.find("ant")
    return catalog.make(info, catalog.parse_options(info, {}), engine_builder("native"))


def test_an_episode_ends_where_the_environment_ends_it() -> None:
    # Two steps, the second brings 1.
    [episode] = rollout(
        probes.delayed_reward(), zero_policy(1), key=KEY, num_steps=10, num_episodes=1
    ).episodes
    assert episode.terminated
    np.testing.assert_array_equal(episode.reward, [0.0, 1.0])
    np.testing.assert_array_equal(episode.observation[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(episode.time, [0.0, 1.0, 2.0])


def test_an_episode_that_nothing_ends_is_cut_off() -> None:
    # Longer than one compiled call, and no multiple of it.
    [episode] = rollout(
        probes.endless(), constant_policy([0.5]), key=KEY, num_steps=450, num_episodes=1
    ).episodes
    assert not episode.terminated
    np.testing.assert_array_equal(episode.reward, np.full(450, 0.5))
    np.testing.assert_array_equal(episode.observation[:, 0], np.arange(451))
    np.testing.assert_array_equal(episode.metrics["x_velocity"], np.full(450, 0.5))


@dataclass(frozen=True)
class _Chased(Wrapped):
    """The target moves by one metre in every step."""

    dt = 1.0
    episode_length = 8

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        state = self.environment.reset(key, model)
        return replace(state, info={"target_position": jnp.array([2.0, 0.0])})

    def step(self, state: State, action: jax.Array) -> State:
        after = self.environment.step(state, action)
        return replace(after, info={"target_position": state.info["target_position"] + 1.0})


def test_where_an_environment_says_its_target_it_is_kept_with_every_state() -> None:
    trajectory = rollout(_Chased(probes.endless()), zero_policy(1), key=KEY, num_steps=3, num_episodes=1)
    [episode] = trajectory.episodes
    np.testing.assert_array_equal(episode.target, [[2, 0], [3, 1], [4, 2], [5, 3]])
    np.testing.assert_array_equal(cut(episode, 1).target, [[2, 0], [3, 1]])
    _, target = initial_positions(_Chased(probes.endless()), seed=0)
    np.testing.assert_array_equal(target, [2, 0])
    assert initial_positions(probes.endless(), seed=0)[1] is None


@dataclass(frozen=True)
class _Told(Wrapped):
    """A ball that faces along y, goes there by 1 m/s and turns; what it is told changes in each step."""

    dt = 1.0
    episode_length = 8
    tracked_body = 1
    recorded = {"command": "told"}
    ball = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )

    @property
    def model(self) -> mujoco.MjModel:
        return self.ball

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        state = self.environment.reset(key, model)
        half = np.sqrt(0.5)
        physics = replace(
            state.physics,
            qpos=jnp.array([0, 0, 0, half, 0, 0, half]),
            qvel=jnp.array([0, 1.0, 0, 0, 0, 0.5]),
        )
        return replace(state, physics=physics, info={"told": jnp.array([1.0, 0.0, 0.25])})

    def step(self, state: State, action: jax.Array) -> State:
        return replace(self.environment.step(state, action), info={"told": state.info["told"] + 1.0})


def test_what_an_environment_tells_is_kept_beside_what_its_body_does() -> None:
    [episode] = rollout(
        _Told(probes.endless()), zero_policy(1), key=KEY, num_steps=2, num_episodes=1
    ).episodes
    np.testing.assert_array_equal(episode.command, [[1, 0, 0.25], [2, 1, 1.25], [3, 2, 2.25]])
    # In its own frame it goes forward, and turns to the left.
    np.testing.assert_allclose(episode.velocity, np.tile([1, 0, 0.5], (3, 1)), atol=1e-6)
    shorter = cut(episode, 1)
    assert shorter.command is not None
    assert shorter.velocity is not None
    assert len(shorter.command) == len(shorter.velocity) == 2


def test_random_actions_fill_the_range_and_depend_on_the_key_alone() -> None:
    roller = Roller(probes.endless(), lambda _, observation, key: random_policy(1)(observation, key))
    first, again = (next(roller.episodes(None, KEY, num_steps=200, num_episodes=1)) for _ in range(2))
    other = next(roller.episodes(None, jax.random.key(1), num_steps=200, num_episodes=1))
    np.testing.assert_array_equal(first.action, again.action)
    assert not np.array_equal(first.action, other.action)
    assert -1.0 <= first.action.min() < -0.9
    assert 0.9 < first.action.max() <= 1.0
    assert abs(first.action.mean()) < 0.15


def test_l1_the_first_random_action_is_drawn_apart_from_the_initial_velocities() -> None:
    """As the audit's rollout_keys.py compares them: they were equal."""
    info, options = catalog.resolve("hopper", {})
    hopper = catalog.make(info, options, engine_builder("native"), None)
    drawn = rollout(hopper, random_policy(3), key=jax.random.PRNGKey(3), num_steps=1, num_episodes=3)
    for episode in drawn.episodes:
        noise = episode.qvel[0][:3] / options.reset_noise_scale
        assert not np.isclose(noise, episode.action[0], atol=1e-3).any()


@pytest.mark.parametrize(
    ("name", "row", "said"),
    [
        ("qpos", 2, (2, "qpos")),
        ("observation", 0, (0, "observation")),
        ("action", 2, (3, "action")),
        ("reward", 0, (1, "reward")),
        ("qvel", 4, (4, "qvel")),
    ],
)
def test_m2_the_first_number_of_an_episode_that_is_not_finite_is_found(
    name: str, row: int, said: tuple[int, str]
) -> None:
    states = {"qpos": (5, 2), "qvel": (5, 2), "observation": (5, 3), "action": (4, 1), "reward": (4,)}
    arrays = {one: np.zeros(shape, np.float32) for one, shape in states.items()}
    whole = Episode(time=np.arange(5.0), position=np.zeros((5, 3), np.float32), terminated=False, **arrays)
    assert not_finite(whole) is None
    spoilt = np.array(arrays[name])
    spoilt[row:] = np.nan
    assert not_finite(replace(whole, **{name: spoilt})) == said
    # What comes of it later is not what is named.
    later = np.array([0, 0, 0, -np.inf], np.float32)
    assert not_finite(replace(whole, **{"reward": later, name: spoilt})) == said


def test_episodes_do_not_depend_on_how_many_run_side_by_side() -> None:
    def act(_: object, observation: jax.Array, key: jax.Array) -> jax.Array:
        return random_policy(1)(observation, key)

    one, many = (
        list(Roller(probes.endless(), act, num_envs=n).episodes(None, KEY, num_steps=20, num_episodes=5))
        for n in (1, 3)
    )
    assert len(one) == len(many) == 5
    for alone, together in zip(one, many, strict=True):
        np.testing.assert_array_equal(alone.action, together.action)


def test_new_parameters_need_no_new_compilation() -> None:
    compiled: list[int] = []

    def act(parameters: jax.Array, observation: jax.Array, key: jax.Array) -> jax.Array:
        compiled.append(1)  # runs while tracing only
        return parameters

    roller = Roller(probes.endless(), act)
    actions = [
        next(roller.episodes(jnp.array([value]), KEY, num_steps=3, num_episodes=1)).action[0, 0]
        for value in (0.25, 0.5)
    ]
    assert actions == [0.25, 0.5]
    assert len(compiled) == 1


@dataclass(frozen=True)
class _WeaklyDone(Wrapped):
    """`done` is weakly typed after a step, and not after a reset, as in most bodies."""

    dt = 1.0
    episode_length = 450

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return self.environment.reset(key, model)

    def step(self, state: State, action: jax.Array) -> State:
        return replace(self.environment.step(state, action), done=jnp.where(action[0] > 1, 1.0, 0.0))


def test_the_states_of_a_step_need_no_new_compilation() -> None:
    traced: list[int] = []

    def act(_: object, state: State, key: jax.Array) -> jax.Array:
        traced.append(1)
        return jnp.zeros(1)

    roller = Roller(_WeaklyDone(probes.endless()), act)
    [episode] = roller.episodes(None, KEY, num_steps=450, num_episodes=1)  # Three compiled calls.
    assert episode.num_steps == 450
    assert len(traced) == 1


def test_footage_goes_on_with_another_episode_and_stops_on_time() -> None:
    # Episodes of two steps of 1 s each; 5 s are two and a half of them.
    roller = Roller(probes.delayed_reward(), lambda _, observation, key: jnp.zeros(1))
    shown = footage(roller, None, KEY, dt=1.0, seconds=5.0)
    assert [episode.num_steps for episode in shown] == [2, 2, 1]
    assert [episode.terminated for episode in shown] == [True, True, False]


def test_footage_of_several_at_once_is_one_episode_of_each_and_those_a_rollout_makes() -> None:
    roller = Roller(probes.delayed_reward(), lambda _, observation, key: jnp.zeros(1), num_envs=3)
    shown = footage(roller, None, KEY, dt=1.0, seconds=5.0, num_at_once=3)
    assert [episode.num_steps for episode in shown] == [2, 2, 2]
    of_a_rollout = rollout(probes.endless(), zero_policy(1), key=KEY, num_steps=9, num_episodes=4).episodes
    first = filmed(of_a_rollout, dt=1.0, seconds=5.0, num_at_once=2)
    assert [episode.num_steps for episode in first] == [5, 5]
    np.testing.assert_array_equal(first[1].qpos, of_a_rollout[1].qpos[:6])
    assert len(filmed(of_a_rollout[:1], dt=1.0, seconds=5.0, num_at_once=2)) == 1


def test_a_cut_episode_keeps_one_state_more_than_actions() -> None:
    [episode] = rollout(probes.endless(), zero_policy(1), key=KEY, num_steps=9, num_episodes=1).episodes
    shorter = cut(episode, 4)
    assert (shorter.num_steps, len(shorter.time), len(shorter.metrics["x_velocity"])) == (4, 5, 4)
    assert cut(episode, 9) is episode


def test_the_ants_trajectory_is_what_its_model_does(ant: Environment) -> None:
    recorded = rollout(ant, random_policy(8), key=KEY, num_steps=30, num_episodes=2)
    for episode in recorded.episodes:
        assert episode.qpos.shape == (episode.num_steps + 1, ant.model.nq)
        assert episode.action.shape == (episode.num_steps, ant.action_size)
        # The torso is the free joint's body: its position is the first three of qpos.
        np.testing.assert_allclose(episode.position, episode.qpos[:, :3], atol=1e-6)
        assert episode.time[-1] == pytest.approx(ant.dt * episode.num_steps)
    first = recorded.episodes[0]
    data = mujoco.MjData(ant.model)
    data.qpos[:], data.qvel[:] = first.qpos[0], first.qvel[0]
    data.ctrl[:] = first.action[0]
    for _ in range(round(ant.dt / ant.model.opt.timestep)):
        mujoco.mj_step(ant.model, data)
    np.testing.assert_allclose(first.qpos[1], data.qpos, atol=1e-4)


def test_a_trajectory_says_whose_it_is(ant: Environment) -> None:
    about = trajectory_of(ant, [], environment="ant", seed=7).about
    assert (about["environment"], about["seed"], about["tracked_body"]) == ("ant", 7, "torso")
    assert about["dt_s"] == pytest.approx(0.05)
    assert len(about["actuators"]) == 8


def test_the_keys_of_a_policys_actions_can_be_made_again() -> None:
    roller = Roller(probes.endless(), lambda _, state, key: jax.random.uniform(key, (1,)), num_envs=2)
    *_, last = roller.episodes(None, KEY, num_steps=4, num_episodes=3)
    again = jax.vmap(lambda key: jax.random.uniform(key, (1,)))(action_keys(KEY, 2, 4))
    np.testing.assert_array_equal(last.action, again)
