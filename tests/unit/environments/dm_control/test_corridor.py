"""Walkers in corridors: the notebook's reward, the arena of a seed, and dm_control's own dynamics."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.algorithms.catalog import resolve
from core.algorithms.ppo.spec import PPOSpec
from core.environments import catalog, optional_packages
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.model import composed, corridor_model, obstacles
from core.environments.dm_control.corridor.walkers import WALKERS, Walker
from core.environments.environment import State
from core.errors import JobFailed, Rejected
from core.jobs.checks import check
from core.jobs.spec import JOB_SPEC
from core.jobs.store import JobStore
from core.physics import availability
from core.physics.availability import choose
from core.physics.choose import engine_builder
from core.physics.model import initial_qpos

# Where the ant stands when it does nothing.
RESTING_HEIGHT_M = 0.36
GRAVITY = 9.81


@dataclass(frozen=True)
class Case:
    model: mujoco.MjModel
    trunk: int
    reset: Callable[[jax.Array], State]
    step: Callable[[State, jax.Array], State]


@cache
def build(walker: Walker = "ant", **options: object) -> Case:
    info = catalog.find("corridor")
    parsed = catalog.parse_options(info, {"walker": walker, **options})
    environment = catalog.make(info, parsed, engine_builder("native"))
    row = info.under(parsed)
    assert (row.observation_size, row.action_size) == (
        environment.observation_size,
        environment.action_size,
    )
    assert row.dt == pytest.approx(environment.dt)
    assert row.episode_length == environment.episode_length
    model = environment.model
    assert row.cameras == tuple(model.camera(index).name for index in range(model.ncam))
    return Case(model, environment.tracked_body, jax.jit(environment.reset), jax.jit(environment.step))


def refusal(**options: object) -> str:
    with pytest.raises(Rejected) as refused:
        catalog.parse_options(catalog.find("corridor"), options)
    return refused.value.detail


def obstacle_ends(model: mujoco.MjModel) -> list[float]:
    return [obstacle.end for obstacle in obstacles(model)]


def moved_to(state: State, x: float, y: float = 0.0, dz: float = 0.0) -> State:
    """The state with the walker elsewhere; its derived fields are of where it was."""
    qpos = state.physics.qpos.at[:2].set(jnp.array([x, y])).at[2].add(dz)
    return replace(state, physics=replace(state.physics, qpos=qpos))


def test_rewards_and_observations_are_the_notebooks_over_plain_mujoco() -> None:
    case = build()
    state = case.reset(jax.random.key(3))
    for index in range(5):
        action = jax.random.uniform(jax.random.key(index), (8,), minval=-1.0, maxval=1.0)
        before = np.asarray(state.physics.derived["subtree_com"][case.trunk])
        data = mujoco.MjData(case.model)
        data.qpos[:], data.qvel[:] = state.physics.qpos, state.physics.qvel
        data.qacc_warmstart[:], data.ctrl[:] = state.physics.qacc_warmstart, action
        mujoco.mj_step(case.model, data, 5)
        mujoco.mj_kinematics(case.model, data)
        mujoco.mj_comPos(case.model, data)
        state = case.step(state, action)
        after = data.body("walker/torso").subtree_com
        speed = (after - before)[0] / 0.01
        # The weights of the notebook: 5 for speed, 5 for the distance, 0.5 for being up, 0.1 for the action.
        terms = (5 * speed, 5 * speed * 0.01, 0.5, -0.1 * np.sum(np.square(action)))
        np.testing.assert_allclose(state.reward, sum(terms), rtol=1e-3, atol=1e-3)
        names = ("forward_reward", "distance_reward", "reward_alive", "reward_quadctrl")
        np.testing.assert_allclose([state.metrics[name] for name in names], terms, rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(state.metrics["height"], data.body("walker/torso").xpos[2], atol=1e-6)
        np.testing.assert_allclose(state.metrics["distance_from_origin"], np.linalg.norm(after), rtol=1e-6)
        expected = np.concatenate([data.qpos[2:], data.qvel])
        np.testing.assert_allclose(state.obs, expected, rtol=1e-4, atol=1e-4)


def test_what_is_followed_is_the_walker_and_never_the_arena() -> None:
    case = build()
    assert case.model.body(case.trunk).name == "walker/torso"
    assert case.trunk > 1  # where the notebook's first attempt looked for it are the walls
    state = case.reset(jax.random.key(0))
    np.testing.assert_allclose(state.physics.derived["subtree_com"][case.trunk, 0], 5.0, atol=0.05)


def test_it_stands_where_it_is_put_when_it_does_nothing() -> None:
    case = build(reset_noise_scale=0.0)
    state = case.reset(jax.random.key(0))
    for _ in range(20):
        state = case.step(state, jnp.zeros(8))
    assert float(state.metrics["height"]) == pytest.approx(RESTING_HEIGHT_M, abs=0.01)
    assert float(state.reward) == pytest.approx(0.5, abs=0.02)
    assert float(state.done) == 0


def test_equal_seeds_give_equal_gaps_and_others_give_others() -> None:
    once, again, other = (
        corridor_model(CorridorOptions(arena_seed=seed, corridor_length=15)) for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(once.geom_pos, again.geom_pos)
    np.testing.assert_array_equal(once.geom_size, again.geom_size)
    assert not np.array_equal(obstacle_ends(once), obstacle_ends(other)[: len(obstacle_ends(once))])


def test_lengths_are_what_the_options_say() -> None:
    model = corridor_model(
        CorridorOptions(
            gap_length=(0.3, 0.4), platform_length=(1.0, 1.2), corridor_width=3, corridor_length=12
        )
    )
    floors = [geom for geom in map(model.geom, range(model.ngeom)) if geom.name.startswith("floor_")]
    begins, ends = ([float(g.pos[0] + sign * g.size[0]) for g in floors] for sign in (-1, 1))
    # dm_control lets a platform follow the first, of 6 m, without a gap; then a gap comes after each.
    assert begins[0] == pytest.approx(6.0)
    gaps = np.subtract(begins[1:], ends[:-1])
    assert ((gaps >= 0.3) & (gaps <= 0.4)).all()
    lengths = np.subtract(ends[:-1], begins[:-1])
    assert ((lengths >= 1.0) & (lengths <= 1.2)).all()
    np.testing.assert_allclose(obstacle_ends(model), begins[1:])
    assert {float(g.size[1]) for g in floors} == {1.5}
    # Behind the last there is ground up to the wall that ends the corridor.
    assert ends[-1] == pytest.approx(14.0)


@pytest.mark.extra
def test_a_fall_into_a_gap_ends_the_episode_whatever_the_range() -> None:
    case = build(gap_length=(3.0, 3.0), platform_length=(1.0, 1.0), terminate_when_unhealthy=False)
    [_, second, *_] = obstacle_ends(case.model)
    state = moved_to(case.reset(jax.random.key(0)), second - 1.5)
    # From rest at 0.36 m it is below the ground after sqrt(2 · 0.36 / 9.81) = 0.27 s of free fall.
    done: list[float] = []
    for _ in range(32):
        state = case.step(state, jnp.zeros(8))
        done.append(float(state.done))
    # The pose was lifted by the noise's scale, 1 cm, and the noise itself is as large.
    assert done.index(1.0) * 0.01 == pytest.approx(np.sqrt(2 * RESTING_HEIGHT_M / GRAVITY), abs=0.03)
    assert float(state.metrics["fell"]) == 1.0


def test_gaps_that_are_behind_are_counted() -> None:
    case = build()
    first, second, *_ = obstacle_ends(case.model)
    # The centre of mass is above the free joint, to within a few centimetres.
    start = case.step(moved_to(case.reset(jax.random.key(0)), first + 0.3), jnp.zeros(8))
    beyond = case.step(moved_to(start, second + 0.3), jnp.zeros(8))
    assert float(beyond.metrics["obstacles_passed"]) == 1.0
    assert float(case.step(beyond, jnp.zeros(8)).metrics["obstacles_passed"]) == 0.0


def test_what_is_ahead_is_shown_where_it_is_asked_for() -> None:
    case = build(num_next_obstacles=2)
    first, second, third, *_, last = obstacles(case.model)
    still = jnp.zeros(8)

    def seen(x: float, y: float) -> np.ndarray:
        state = case.step(moved_to(case.reset(jax.random.key(0)), x, y), still)
        x, y = state.physics.qpos[:2]
        return np.asarray(state.obs[-6:]) + np.array([x, x, y, x, x, y])

    np.testing.assert_allclose(seen(5.0, 0.3), [*first[:2], 0.0, *second[:2], 0.0], atol=1e-5)
    np.testing.assert_allclose(seen(first.end + 0.1, 0.0), [*second[:2], 0.0, *third[:2], 0.0], atol=1e-5)
    # Behind the last one there is nothing, and what is nothing is 10 m ahead and straight on.
    state = case.step(moved_to(case.reset(jax.random.key(0)), last.end + 0.1, 0.5), still)
    np.testing.assert_array_equal(state.obs[-6:], [10.0, 10.0, 0.0, 10.0, 10.0, 0.0])


def test_the_way_past_a_wall_is_the_middle_of_what_it_leaves() -> None:
    options: dict[str, Any] = {"arena": "walls", "corridor_width": 5.0}
    model = corridor_model(CorridorOptions(**options))
    walls = [geom for geom in map(model.geom, range(model.ngeom)) if geom.name.startswith("wall_")]
    for wall, obstacle in zip(walls, obstacles(model), strict=True):
        inner = wall.pos[1] - np.sign(wall.pos[1]) * wall.size[1]
        outer = -np.sign(wall.pos[1]) * 2.5
        assert obstacle.y == pytest.approx((inner + outer) / 2)
    case = build(num_next_obstacles=1, **options)
    state = case.reset(jax.random.key(0))
    np.testing.assert_allclose(state.obs[-1], obstacles(model)[0].y - state.physics.qpos[1], atol=1e-5)


def test_out_of_the_healthy_range_ends_it_or_costs_the_reward() -> None:
    for ends in (True, False):
        case = build(healthy_z_range=(0.2, 1.0), terminate_when_unhealthy=ends)
        state = case.step(moved_to(case.reset(jax.random.key(0)), 5.0, dz=1.0), jnp.zeros(8))
        assert float(state.done) == float(ends)
        assert float(state.metrics["reward_alive"]) == (0.5 if ends else 0.0)
        assert float(state.metrics["fell"]) == 1.0


def test_a_range_in_which_it_cannot_begin_is_refused_where_that_would_end_it() -> None:
    # The notebook's, which was made for an ant.
    options: dict[str, Any] = {"walker": "rodent", "healthy_z_range": [0.2, 1.0]}
    assert "the body starts at 0.047 m, outside healthy_z_range = [0.2, 1]" in refusal(**options)
    catalog.parse_options(
        catalog.find("corridor"), {"arena": "empty", "terminate_when_unhealthy": False, **options}
    )


def test_in_the_air_it_moves_as_dm_control_composed_it() -> None:
    # Nothing touches: contacts, cone and what follows the solver play no part, and joint limits are solved
    # to the same tolerance (1e-8 of the solver's scale) in both.
    ends = [_moved(model, lift=3.0, seconds=0.4, effort=1.0) for model in _as_composed_and_ours("ant")]
    assert np.abs(ends[0][7:]).max() > 0.1
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)


def test_at_rest_it_stands_as_dm_control_composed_it() -> None:
    # Contacts that stick do not see the cone's form. What is left is the search against slipping, which
    # holds the composed one where ours may creep: the solver's regularised friction lets a contact slide
    # at a rate set by its time constant. A millimetre in 0.2 s, of 0.8 m of leg.
    ends = [_moved(model, lift=0.0, seconds=0.2, effort=0.0) for model in _as_composed_and_ours("ant")]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)


def test_with_its_feet_on_the_ground_it_slides_as_far_as_a_pyramid_may_differ_from_a_cone() -> None:
    # A pyramid holds between mu / sqrt(2) and mu, mu = 1: so accelerations of the whole differ by at most
    # (1 - 1 / sqrt(2)) g = 2.9 m/s², and places after t = 0.1 s by half of that t² = 1.4 cm.
    composed_model, ours = _as_composed_and_ours("ant")
    ends = [_moved(model, lift=0.0, seconds=0.1, effort=0.5) for model in (composed_model, ours)]
    assert np.abs(ends[0][7:] - initial_qpos(ours)[7:]).max() > 0.02
    np.testing.assert_allclose(ends[1][:3], ends[0][:3], atol=0.0144)


def _as_composed_and_ours(walker: Walker) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    options = CorridorOptions(walker=walker, corridor_length=12)
    return composed(options)[0].compile(), corridor_model(options)


def _moved(model: mujoco.MjModel, *, lift: float, seconds: float, effort: float) -> np.ndarray:
    """Where plain MuJoCo brings it, [nq], from our initial pose under one random control."""
    data = mujoco.MjData(model)
    data.qpos[:] = initial_qpos(_as_composed_and_ours("ant")[1])
    data.qpos[2] += lift
    data.ctrl[:] = effort * np.random.default_rng(0).uniform(-1.0, 1.0, model.nu)
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    return np.array(data.qpos)


def test_limbs_meet_the_ground_and_only_the_trunk_meets_the_sides() -> None:
    model = corridor_model(CorridorOptions(arena="walls", corridor_length=12))
    may_touch: dict[str, set[str]] = {"ground": set(), "side": set(), "wall": set(), "walker": set()}
    for one in range(model.ngeom):
        for other in range(model.ngeom):
            body = model.body(model.geom_bodyid[other]).name
            if body.startswith("walker/") and model.geom_contype[one] & model.geom_conaffinity[other]:
                may_touch[_kind(model, one)].add(body)
    assert may_touch["side"] == {"walker/torso"}
    assert len(may_touch["ground"]) == 13
    assert may_touch["wall"] == may_touch["ground"]
    assert not may_touch["walker"]


def _kind(model: mujoco.MjModel, geom: int) -> str:
    body = model.body(model.geom_bodyid[geom]).name
    if body.startswith("walker/"):
        return "walker"
    if body == "walls":
        return "wall"
    return "side" if model.geom_quat[geom][0] < 0.9 else "ground"


@pytest.mark.extra
@pytest.mark.parametrize("walker", ["rodent", "humanoid"])
def test_the_other_walkers_stand_in_it_too(walker: Walker) -> None:
    case = build(walker, corridor_length=10)
    low, high = WALKERS[walker].healthy_z_range
    start = case.reset(jax.random.key(0)).physics.derived["xpos"][case.trunk, 2]
    assert start == pytest.approx(WALKERS[walker].standing_height, abs=0.02)
    state = case.reset(jax.random.key(0))
    for _ in range(5):
        state = case.step(state, jnp.zeros(case.model.nu))
    assert low < float(state.metrics["height"]) < high
    assert np.isfinite(state.obs).all()
    assert float(state.done) == 0
    assert abs(float(state.metrics["x_velocity"])) < 0.5


def test_a_walker_that_lies_is_not_healthy() -> None:
    # Left to itself, the humanoid falls down; it lies at 0.11 m.
    case = build("humanoid", corridor_length=10)
    data = mujoco.MjData(case.model)
    data.qpos[:] = initial_qpos(case.model)
    mujoco.mj_step(case.model, data, 1500)
    assert data.xpos[case.trunk][2] < WALKERS["humanoid"].healthy_z_range[0]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"gap_length": [0.3, 0.2]}, "gap_length: [0.3, 0.2] is not [low, high] with low ≤ high"),
        ({"gap_length": [1, 34]}, "gap_length goes up to 34 m"),
        ({"gap_length": [-0.1, 0.2]}, "gap_length: must not be negative"),
        ({"corridor_width": 1.0}, "corridor_width = 1 m is too narrow: the ant needs 2 m"),
        ({"corridor_width": 0.4, "walker": "rodent"}, "the rodent needs 0.6 m"),
        ({"arena": "walls", "wall_width": [1, 4]}, "which leaves 1 m of the corridor's 5 m to pass"),
        ({"platform_length": [0, 0.1], "gap_length": [0, 0]}, "platform_length must be above 0"),
        ({"platform_length": [0.05, 0.1], "gap_length": [0, 0.1]}, "680 platforms; at most 200 are allowed"),
        ({"start_x": 6.0}, "start_x = 6 m leaves no room to stand"),
        ({"walker": "cat"}, "walker: Input should be 'ant', 'rodent', 'humanoid',"),
        ({"arena": "maze"}, "arena: Input should be 'empty', 'gaps' or 'walls'"),
        ({"gap": 1}, "gap: there is no such option"),
    ],
)
def test_what_cannot_be_built_is_refused(options: dict[str, object], sentence: str) -> None:
    assert sentence in refusal(**options)


def test_lengths_of_an_arena_that_is_not_asked_for_are_not_looked_at() -> None:
    CorridorOptions(arena="empty", gap_length=(30, 39), wall_width=(4, 5))


def test_mjx_is_refused_where_ellipsoids_meet_boxes() -> None:
    info = catalog.find("corridor")
    for walker, arena, refused in [
        ("rodent", "gaps", True),
        ("humanoid", "walls", True),
        ("rodent", "empty", False),
        ("ant", "gaps", False),
    ]:
        row = info.under(catalog.parse_options(info, {"walker": walker, "arena": arena}))
        if refused:
            with pytest.raises(Rejected, match="no contacts between ellipsoids and boxes"):
                choose("mjx", "gpu", 64, row.on_a_gpu, row.cannot_run)
        else:
            assert choose("mjx", "gpu", 64, row.on_a_gpu, row.cannot_run).name == "mjx"


@pytest.mark.parametrize(
    ("walker", "num_layouts", "lacking", "engine"),
    [
        ("ant", 1, set[str](), "compiled"),
        ("ant", 1, {"compiled"}, "warp"),
        ("ant", 1, {"compiled", "warp"}, "native"),
        ("humanoid", 1, set[str](), "warp"),
        ("humanoid", 1, {"warp"}, "native"),
        ("rodent", 1, set[str](), "compiled"),
        ("rodent", 2, set[str](), "compiled"),
    ],
)
def test_a_gpu_gets_what_was_measured_fastest_of_what_is_installed(
    walker: Walker, num_layouts: int, lacking: set[str], engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(availability, "is_installed", lambda name: name not in lacking)
    row = catalog.find("corridor").under(CorridorOptions(walker=walker, num_layouts=num_layouts))
    assert choose("auto", "gpu", 2048, row.on_a_gpu, row.cannot_run).name == engine


def test_a_worker_without_dm_control_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(optional_packages, "import_module", missing)
    with pytest.raises(JobFailed, match="uv sync --inexact --extra dm-control") as failure:
        corridor_model(CorridorOptions())
    assert failure.value.reason == "bad_model"


def test_the_renderers_setting_is_left_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    for value in ("egl", None):
        if value is None:
            monkeypatch.delenv("MUJOCO_GL", raising=False)
        else:
            monkeypatch.setenv("MUJOCO_GL", value)
        composed(CorridorOptions(arena="empty"))
        assert os.environ.get("MUJOCO_GL") == value


@pytest.mark.parametrize(
    ("options", "num_steps"),
    [({}, 4), ({"n_frames": 10}, 2), ({"n_frames": 25, "timestep": 0.004}, 1), ({"walker": "rodent"}, 1)],
)
def test_an_action_of_the_ant_is_held_for_0_04_s(options: dict[str, Any], num_steps: int) -> None:
    # Control steps of 0.01, 0.02 and 0.1 s.
    info = catalog.find("corridor")
    row = info.under(catalog.parse_options(info, options))
    assert resolve(PPOSpec(), row, "cpu").action_repeat == num_steps


@pytest.mark.extra
def test_a_job_is_judged_by_the_walker_that_it_asks_for(jobs: JobStore) -> None:
    environment: dict[str, Any] = {"id": "corridor", "options": {"walker": "rodent", "episode_length": 300}}
    policy = {"kind": "constant", "action": [0.0] * 38}
    job = {"kind": "rollout", "environment": environment, "policy": policy, "video": {"camera": "walker/top"}}
    check(JOB_SPEC.validate_python(job), jobs)
    info = catalog.find("corridor")
    row = info.under(catalog.parse_options(info, environment["options"]))
    assert resolve(PPOSpec(), row, "cpu").episode_length == 300
