"""Brittle stars: what can be set about them, where targets and walls are, how light falls, bad input."""

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.algorithms.catalog import resolve
from core.algorithms.dqn.spec import DQNSpec
from core.algorithms.ppo.spec import PPOSpec
from core.algorithms.q_learning.spec import QLearningSpec
from core.environments import catalog, optional_packages
from core.environments.brittle_star import model as composing
from core.environments.brittle_star.info import INFOS
from core.environments.brittle_star.model import star_model
from core.environments.brittle_star.options import DirectedOptions, LightEscapeOptions, UndirectedOptions
from core.environments.brittle_star.tasks import light_at, light_map
from core.environments.info import FiniteSpace
from core.errors import JobFailed, Rejected
from core.physics import availability
from core.physics.availability import PACKAGES, choose
from core.physics.choose import engine_builder

STARS = [info.id for info in INFOS]


@cache
def build(task: str = "brittle_star", **options: Any) -> Any:
    """The environment; its row says of it what is true."""
    info = catalog.find(task)
    parsed = catalog.parse_options(info, {name: _listed(value) for name, value in options.items()})
    environment = catalog.make(info, parsed, engine_builder("native"))
    row = info.under(parsed)
    assert row.observation_size == environment.observation_size
    assert row.action_size == environment.action_size
    views = environment.discretization
    assert row.finite.state_discretizers == {
        kind: FiniteSpace(view.num_states, view.num_parts) for kind, view in views.state_discretizers.items()
    }
    assert row.finite.action_sets == {
        kind: FiniteSpace(view.num_choices, view.num_parts) for kind, view in views.action_sets.items()
    }
    assert row.episode_length == environment.episode_length
    assert row.dt == pytest.approx(environment.dt)
    model = environment.model
    assert row.cameras == tuple(model.camera(index).name for index in range(model.ncam))
    return environment


def environment_options(task: str = "brittle_star", **options: Any) -> Any:
    return catalog.parse_options(catalog.find(task), options)


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def refusal(task: str = "brittle_star", **options: Any) -> str:
    with pytest.raises(Rejected) as refused:
        catalog.parse_options(catalog.find(task), options)
    return refused.value.detail


@pytest.mark.parametrize("num_arms", [3, 8])
def test_arms_stand_evenly_around_the_disk_however_many(num_arms: int) -> None:
    model = build(num_arms=num_arms, num_segments_per_arm=1).model
    arms = [model.body(f"BrittleStarMorphology/arm_{index}").pos for index in range(num_arms)]
    angles = np.unwrap([np.arctan2(y, x) for x, y, _ in arms])
    np.testing.assert_allclose(np.diff(angles), 2 * np.pi / num_arms)
    # One side and one socket for each: a polygon of so many corners, and some of the mass below each arm.
    geoms = [model.geom(index).name for index in range(model.ngeom)]
    assert sum("_pentagon_side_" in name for name in geoms) == num_arms
    sockets = [model.geom(name) for name in geoms if "_arm_connector_" in name]
    for socket, arm in zip(sockets, arms, strict=True):
        np.testing.assert_allclose(socket.pos / 0.1, arm / 0.125, atol=1e-9)


def test_five_arms_on_a_disk_of_ours_weigh_what_biorobots_do() -> None:
    spec = composing.composed(DirectedOptions(num_segments_per_arm=1))
    theirs = spec.compile()
    from core.environments.brittle_star.model import _shape_disk

    _shape_disk(spec, 5)
    ours = spec.compile()
    for field in ("body_mass", "body_inertia", "body_ipos", "geom_pos", "geom_size"):
        values, expected = (np.sort(getattr(model, field).ravel()) for model in (ours, theirs))
        np.testing.assert_allclose(values, expected, atol=1e-12, err_msg=field)


def test_an_arm_may_be_missing() -> None:
    environment = build(num_arms=4, num_segments_per_arm=(2, 0, 1, 3))
    assert environment.action_size == 2 * (2 + 0 + 1 + 3)
    assert environment.discretization.state_discretizers["arm_role"].num_parts == 4


@pytest.mark.extra
def test_actions_reach_from_end_to_end_of_the_joints_ranges() -> None:
    # Servos of 20 Nm/rad that may pull with 3.75 Nm in an arm's first segment: at 45° and 30° from where the
    # joints are, 15.7 and 10.5 Nm are cut off at that. Torques are the same ends.
    for actuation in ("p_control", "torque_control"):
        environment = build(actuation=actuation, num_segments_per_arm=1)
        state = environment.step(environment.reset(jax.random.key(0)), jnp.ones(10))
        np.testing.assert_allclose(state.physics.derived["qfrc_actuator"][6:], 3.75, rtol=1e-6)


@pytest.mark.extra
def test_a_pattern_generator_may_move_the_joints() -> None:
    # Arm 0 leads, held up by three quarters of 30°, and the others row: the star leaves its place towards +x
    # by more than its own noise in two seconds.
    environment = build(control="cpg", num_segments_per_arm=3)
    row = catalog.find("brittle_star").under(environment_options(control="cpg"))
    assert set(row.finite.action_sets) == {"leading_arm", "arm_roles", "arm_amplitudes"}
    state, step = environment.reset(jax.random.key(0)), jax.jit(environment.step)
    action = environment.leading_arm(0)
    assert action.shape == (7 * 5 + 1,)
    for _ in range(75):
        state = step(state, action)
    lifted = state.physics.qpos[8:13:2]
    assert float(jnp.min(lifted)) > 0.1
    assert float(state.metrics["x_position"]) > 0.02


@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_a_table_needs_nothing_said_to_steer_by_a_pattern_generator(device: Any) -> None:
    given = environment_options(control="cpg", simulation_time=30.0)
    settings = resolve(QLearningSpec(), catalog.find("brittle_star").under(given), device)
    assert settings.state_discretizer is not None
    assert settings.action_set is not None
    assert (settings.state_discretizer.kind, settings.action_set.kind) == (
        "arm_towards_target",
        "leading_arm",
    )
    # A decision is one stroke of 1 Hz: 30 s have as many.
    assert settings.decision_steps * given.dt == pytest.approx(1 / given.cpg.gait.frequency_hz)
    assert settings.decisions_per_episode == 30
    with pytest.raises(Rejected, match="Name a `state_discretizer`"):
        resolve(QLearningSpec(), catalog.find("brittle_star").under(environment_options()), device)


@pytest.mark.parametrize("device", ["cpu", "gpu"])
def test_a_network_of_values_needs_nothing_said_either(device: Any) -> None:
    given = environment_options(control="cpg", simulation_time=30.0)
    settings = resolve(DQNSpec(), catalog.find("brittle_star").under(given), device)
    assert settings.action_set is not None
    assert settings.action_set.kind == "leading_arm"
    # A decision is one stroke of 1 Hz, and 30 s have as many.
    assert settings.action_repeat * given.dt == pytest.approx(1 / given.cpg.gait.frequency_hz)
    assert settings.actions_per_episode == 30
    with pytest.raises(Rejected, match="Name an `action_set`"):
        resolve(DQNSpec(), catalog.find("brittle_star").under(environment_options()), device)


def test_who_steers_by_a_pattern_generator_is_shown_no_forces_unless_they_are_named() -> None:
    info = catalog.find("brittle_star")
    # Of 25 segments: two forces of a number for each of 50 joints, and a contact for each segment.
    all_of_it, without = (info.under(environment_options(control=it)) for it in ("joints", "cpg"))
    assert all_of_it.observation_size is not None
    assert without.observation_size == all_of_it.observation_size - 2 * 50 - 25
    named = environment_options(control="cpg", observables=["segment_contact"])
    assert info.under(named).observation_size == 25


def test_its_row_names_what_its_states_tell() -> None:
    for task in STARS:
        state = jax.eval_shape(build(task, num_segments_per_arm=1).reset, jax.random.key(0))
        assert set(catalog.find(task).info) == set(state.info)


@pytest.mark.extra
def test_targets_differ_between_environments_and_stay_for_an_episode() -> None:
    environment = build(num_segments_per_arm=1)
    states = jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), 200))
    targets = np.asarray(states.info["target_position"])
    np.testing.assert_allclose(np.linalg.norm(targets[:, :2], axis=1), 3.0, rtol=1e-6)
    quarters = np.floor(np.arctan2(targets[:, 1], targets[:, 0]) / (np.pi / 2))
    # 200 even draws: 50 in each quarter, with a deviation of sqrt(200 · 1/4 · 3/4) = 6.1; four of them.
    assert np.abs(np.unique(quarters, return_counts=True)[1] - 50).max() < 25
    after = jax.jit(jax.vmap(environment.step))(states, jnp.zeros((200, 10)))
    np.testing.assert_array_equal(after.info["target_position"], targets)


def test_what_indexers_read_says_where_the_target_is() -> None:
    environment = build(num_segments_per_arm=1, target_position=(1.5, -2.0), random_initial_rotation=True)
    state = environment.reset(jax.random.key(2))
    info = state.info
    # 3, 4, 5 halved.
    np.testing.assert_allclose(info["xy_direction_to_target"], [0.6, -0.8], rtol=1e-6)
    np.testing.assert_allclose(info["xy_distance_to_target"], 2.5, rtol=1e-6)
    np.testing.assert_allclose(info["disk_position"], [0.0, 0.0, 0.11], atol=1e-7)
    assert np.abs(info["disk_rotation"][2]) > 0.1
    np.testing.assert_allclose(info["disk_rotation"][:2], 0.0, atol=1e-6)
    np.testing.assert_allclose(environment.model.body("target").pos[:2], [1.5, -2.0])
    assert environment.step(state, jnp.zeros(10)).info.keys() == info.keys()


@pytest.mark.extra
@pytest.mark.parametrize(("walls", "furthest"), [("bound", 4.875), ("contacts", 4.9)])
def test_walls_hold_it(walls: str, furthest: float) -> None:
    # Thrown at the wall of y = 5 m with 2 m/s, in water. The bound is a disk's radius, 0.125 m, before it,
    # but for what a limit gives way. biorobot's walls hold at their middle, 5.1 m, and first touch a tip
    # 0.25 m from the centre of the disk, 18° off the way: 5.1 - 0.25 cos 18° = 4.86, and joints give way.
    environment = build(walls=walls, num_segments_per_arm=1, target_position=(0.0, 3.0))
    state = environment.reset(jax.random.key(0))
    qpos, qvel = state.physics.qpos.at[1].set(4.6), state.physics.qvel.at[1].set(2.0)
    state = replace(state, physics=replace(state.physics, qpos=qpos, qvel=qvel))
    step, furthest_y = jax.jit(environment.step), 0.0
    for _ in range(25):
        state = step(state, jnp.zeros(10))
        furthest_y = max(furthest_y, float(state.info["disk_position"][1]))
    assert 4.7 < furthest_y < furthest + 0.02


def test_it_is_slow_in_the_water_and_comes_to_rest_on_the_ground() -> None:
    environment = build(num_segments_per_arm=1)
    state, step = environment.reset(jax.random.key(0)), jax.jit(environment.step)
    for _ in range(40):
        state = step(state, jnp.zeros(10))
    # The disk is 5 cm high, as thick as the arms' first segments are.
    assert float(state.metrics["height"]) == pytest.approx(0.025, abs=0.002)
    assert float(jnp.abs(state.physics.qvel).max()) < 0.01
    # The disk bears some of the weight, too, and has no sensor.
    weight = 9.81 * float(environment.model.body_mass.sum())
    assert 0 < float(state.physics.derived["sensordata"].sum()) <= weight


def test_only_what_is_asked_for_is_observed_and_computed() -> None:
    environment = build(observables=("xy_distance_to_target", "disk_position"), num_segments_per_arm=1)
    state = environment.reset(jax.random.key(0))
    # In biorobot's order, whatever the option's.
    np.testing.assert_allclose(state.obs, [0.0, 0.0, 0.11, 3.0], atol=1e-6)
    assert state.physics.derived == {}
    assert environment.model.nsensor == 0


def test_light_falls_from_one_end_of_the_arena_to_the_other() -> None:
    options = LightEscapeOptions(arena_size=(10, 5))
    light = light_map(options)
    assert light.shape == (250, 500)
    # A pixel's value is that of its left edge, and the last one's is 0: 1 - 500 / 499 (x + 10) / 20 at x.
    points = jnp.array([[-10.0, 0.0], [0.0, 3.0], [5.0, -5.0], [10.0, 5.0]])
    expected = [1.0, 1 - 250 / 499, 1 - 375 / 499, 0.0]
    np.testing.assert_allclose(light_at(jnp.asarray(light), (10, 5), points), expected, atol=1e-6)


def test_beyond_a_wall_there_is_the_light_at_its_foot() -> None:
    # Light that falls by 1 in a pixel, 2 cm, would otherwise be -25 half a metre behind two of the walls.
    light = jnp.asarray(np.random.default_rng(0).uniform(size=(250, 500)).astype(np.float32))
    inside = jnp.array([[-10.0, 0.33], [10.0, 0.33], [1.23, -5.0], [1.23, 5.0]])
    beyond = inside + jnp.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
    values = light_at(light, (10, 5), inside)
    np.testing.assert_allclose(light_at(light, (10, 5), beyond), values, atol=1e-6)
    assert (values.min() >= 0.0) & (values.max() <= 1.0)


def test_equal_seeds_give_equal_patches_of_light_and_the_ground_shows_them() -> None:
    options = {"light_perlin_noise_scale": 5, "num_segments_per_arm": 1}
    environments = [build("brittle_star_light_escape", light_seed=seed, **options) for seed in (1, 2)]
    once, other = (environment._task.light_map for environment in environments)
    np.testing.assert_array_equal(
        once, light_map(LightEscapeOptions(light_seed=1, light_perlin_noise_scale=5))
    )
    assert np.abs(once - other).max() > 0.1
    assert (once.min(), once.max()) == (0.0, 1.0)
    model = environments[0].model
    texture = model.texture("groundplane")
    red = model.tex_data[texture.adr[0] :][: 3 * once.size].reshape(*once.shape, 3)[..., 0].astype(float)
    assert np.corrcoef(red.ravel(), once.ravel())[0, 1] > 0.999


@pytest.mark.parametrize(
    ("task", "options", "sentence"),
    [
        ("brittle_star", {"num_arms": 0}, "num_arms: Input should be greater than or equal to 3"),
        ("brittle_star", {"num_arms": 9}, "num_arms: Input should be less than or equal to 8"),
        ("brittle_star", {"num_segments_per_arm": 0}, "there must be at least one segment"),
        ("brittle_star", {"num_segments_per_arm": -1}, "num_segments_per_arm: must not be negative"),
        ("brittle_star", {"num_segments_per_arm": [5, 5]}, "lists 2 arms, but num_arms = 5"),
        ("brittle_star", {"num_segments_per_arm": 20}, "100 segments; at most 96 are allowed"),
        ("brittle_star", {"arena_size": [10, 0]}, "arena_size.1: Input should be greater than or equal to 1"),
        ("brittle_star", {"arena_size": [1, 1], "num_segments_per_arm": 10}, "the arms reach 1.04 m"),
        ("brittle_star", {"target_distance": 6.0}, "target_distance = 6 m is beyond the arena"),
        ("brittle_star", {"target_position": [11, 0]}, "is outside the arena, ± [10, 5] m"),
        ("brittle_star", {"target_position": [0.1, 0.1]}, "within 0.2 m it counts as reached"),
        (
            "brittle_star",
            {"simulation_time": 4000, "num_physics_steps_per_control_step": 5},
            "at most 100000 are allowed",
        ),
        ("brittle_star", {"observables": ["segment_light_intake"]}, "observables.0: Input should be"),
        ("brittle_star_undirected", {"target_distance": 3.0}, "target_distance: there is no such option"),
        ("brittle_star_light_escape", {"light_perlin_noise_scale": 4}, "does not divide the light map"),
        ("brittle_star_light_escape", {"arena_size": [2, 2]}, "leaves 0.5 m around the disk"),
    ],
)
def test_what_cannot_be_built_is_refused(task: str, options: dict[str, Any], sentence: str) -> None:
    assert sentence in refusal(task, **options)


def test_mjx_is_refused_for_more_segments_than_it_compiles_in_time() -> None:
    info = catalog.find("brittle_star")
    few, many = (
        info.under(catalog.parse_options(info, {"num_segments_per_arm": number})) for number in (10, 11)
    )
    assert choose("mjx", "gpu", 64, few.on_a_gpu, few.cannot_run).name == "mjx"
    with pytest.raises(Rejected, match="55 segments, and MJX does not compile in time with more than 50"):
        choose("mjx", "gpu", 64, many.on_a_gpu, many.cannot_run)


@pytest.mark.parametrize("task", STARS)
@pytest.mark.parametrize(
    ("options", "installed", "engine"),
    [
        ({}, {"compiled", "warp"}, "compiled"),
        ({}, {"warp"}, "warp"),
        ({}, set[str](), "native"),
        # An arm's code would be too long, or no arm is like the others.
        ({"num_segments_per_arm": 6}, {"compiled", "warp"}, "warp"),
        ({"num_segments_per_arm": [5, 5, 5, 5, 4]}, {"compiled", "warp"}, "warp"),
        # So would it with the walls' contacts.
        ({"walls": "contacts"}, {"compiled", "warp"}, "warp"),
    ],
)
def test_a_gpu_gets_the_engine_that_is_quickest_there(
    task: str, options: dict[str, Any], installed: set[str], engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(availability, "is_installed", lambda name: name not in PACKAGES or name in installed)
    info = catalog.find(task)
    row = info.under(catalog.parse_options(info, options))
    assert choose("auto", "gpu", 2048, row.on_a_gpu, row.cannot_run).name == engine


@pytest.mark.parametrize("task", STARS)
def test_its_tuned_settings_are_a_training_of_its_episodes(task: str) -> None:
    info = catalog.find(task)
    row = info.under(catalog.parse_options(info, {"simulation_time": 4.0}))
    for device in ("cpu", "gpu"):
        assert resolve(PPOSpec(), row, device).episode_length == 100


def test_a_worker_without_biorobot_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(optional_packages, "import_module", missing)
    with pytest.raises(JobFailed, match="uv sync --inexact --extra brittle-star") as failed:
        star_model(UndirectedOptions())
    assert failed.value.reason == "bad_model"
