"""Many layouts of a corridor: what each is, which one an episode takes, and how a curriculum leads there."""

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.dm_control.corridor.curriculum import NUM_LEVELS, at_level
from core.environments.dm_control.corridor.environment import Corridor
from core.environments.dm_control.corridor.info import CorridorOptions
from core.environments.dm_control.corridor.layouts import boxes_of, draw_layouts, is_box
from core.environments.dm_control.corridor.model import corridor_model, obstacles
from core.environments.environment import State
from core.environments.rollout import rollout, zero_policy
from core.errors import Rejected
from core.physics.choose import engine_builder

SHORT: dict[str, Any] = {"corridor_length": 12, "num_next_obstacles": 1, "reset_noise_scale": 0.0}
CURRICULUM = {"start": {"gap_length": [0.0, 0.0]}, "over_steps": 1000}


@cache
def built(**changed: Any) -> Corridor:
    return Corridor(CorridorOptions(**SHORT, **changed), engine_builder("native"))


def options(**changed: Any) -> CorridorOptions:
    return CorridorOptions.model_validate(changed)


def started(environment: Any, number: int) -> State:
    return jax.jit(jax.vmap(environment.reset))(jax.random.split(jax.random.key(0), number))


def refusal(**changed: Any) -> str:
    with pytest.raises(Rejected) as refused:
        catalog.parse_options(catalog.find("corridor"), changed)
    return refused.value.detail


@pytest.mark.parametrize("arena", ["gaps", "walls"])
def test_a_layout_has_the_lengths_that_dm_control_draws_from_its_seed(arena: Any) -> None:
    for seed in (3, 123456):
        chosen = options(arena=arena, arena_seed=seed, corridor_length=25)
        model = corridor_model(chosen)
        geoms = [geom for geom in map(model.geom, range(model.ngeom)) if is_box(geom.name)]
        ours = boxes_of(chosen, seed)
        np.testing.assert_allclose([geom.pos for geom in geoms], ours[:, 0], atol=1e-12)
        np.testing.assert_allclose([geom.size for geom in geoms], ours[:, 1], atol=1e-12)


def test_the_layouts_are_those_of_the_seeds_that_follow_each_other() -> None:
    layouts = draw_layouts(options(arena_seed=7, num_layouts=3, corridor_length=25))
    for number in range(3):
        alone = boxes_of(options(corridor_length=25), 7 + number)
        np.testing.assert_array_equal(layouts.boxes[number, : len(alone)], alone)
        # What a layout has too many of is behind the end at 27 m, where nothing gets.
        assert (layouts.boxes[number, len(alone) :, 0, 0] > 100).all()


def test_one_layout_is_the_environment_as_it_was() -> None:
    state = built().reset(jax.random.key(0))
    assert not state.physics.model
    assert not state.info


@pytest.mark.extra
def test_each_start_takes_a_layout_by_its_key_and_moves_and_sees_by_it() -> None:
    environment = built(num_layouts=3)
    state = started(environment, 8)
    drawn = np.asarray(state.info["layout"])
    assert set(drawn.tolist()) == {0, 1, 2}
    again = jax.jit(environment.reset)(jax.random.split(jax.random.key(0), 8)[5])
    assert int(again.info["layout"]) == drawn[5]
    for env, number in enumerate(drawn.tolist()):
        alone = corridor_model(CorridorOptions(**SHORT, arena_seed=123456 + number))
        first = obstacles(alone)[0]
        np.testing.assert_allclose(state.obs[env, -3:], [first.begin - 5, first.end - 5, 0.0], atol=1e-5)
        # Half a metre above the middle of the first gap, to which it falls freely or not at all.
        data = mujoco.MjData(alone)
        data.qpos[:] = state.physics.qpos[env]
        data.qpos[0] = first.begin
        fallen = _dropped(environment, state, env, first.begin)
        mujoco.mj_step(alone, data, 50)
        np.testing.assert_allclose(fallen.physics.qpos, data.qpos, atol=1e-4)


@cache
def _stepper(environment: Corridor) -> Any:
    return jax.jit(environment.step)


def _dropped(environment: Corridor, states: State, env: int, x: float) -> State:
    """One of the states, moved to x, after ten control steps without control."""
    state = jax.tree.map(lambda values: values[env], states)
    state = replace(state, physics=replace(state.physics, qpos=state.physics.qpos.at[0].set(x)))
    for _ in range(10):
        state = _stepper(environment)(state, jnp.zeros(8))
    return state


def test_metrics_say_how_much_of_the_way_is_behind() -> None:
    environment = built(num_layouts=3)
    state = jax.tree.map(lambda values: values[0], started(environment, 1))
    last = obstacles(corridor_model(CorridorOptions(**SHORT, arena_seed=123456 + int(state.info["layout"]))))[
        -1
    ]
    totals = {"way_passed": 0.0, "success": 0.0}
    # From 5 m to half of the way, then past the last gap, and on. The step itself moves it by millimetres.
    for x in ((5 + last.end) / 2, last.end + 0.3, last.end + 0.5):
        state = replace(state, physics=replace(state.physics, qpos=state.physics.qpos.at[0].set(x)))
        state = _stepper(environment)(state, jnp.zeros(8))
        if x < last.end:
            assert float(state.metrics["way_passed"]) == pytest.approx(0.5, abs=0.02)
            assert float(state.metrics["success"]) == 0.0
        totals = {name: value + float(state.metrics[name]) for name, value in totals.items()}
    assert totals == {"way_passed": pytest.approx(1.0, abs=1e-5), "success": 1.0}


def test_the_levels_go_from_the_curriculums_lengths_to_the_options_own() -> None:
    chosen = options(gap_length=[0.1, 0.3], curriculum=CURRICULUM)
    middle = at_level(chosen, chosen.curriculum, (NUM_LEVELS - 1) // 3)  # level 5 of 0 to 15
    assert middle.gap_length == pytest.approx((0.1 / 3, 0.1))
    assert at_level(chosen, chosen.curriculum, NUM_LEVELS - 1) is chosen
    layouts = draw_layouts(chosen)
    gaps = [int(np.isfinite(rows[:, 0]).sum()) for rows in layouts.obstacles]
    assert gaps[0] == 0  # Gaps of no length are none.
    assert gaps[-1] == len(obstacles(corridor_model(options(gap_length=[0.1, 0.3]))))


@pytest.mark.extra
def test_fresh_starts_follow_the_progress_and_by_default_are_those_of_the_end() -> None:
    environment = built(num_layouts=2, curriculum=options(curriculum=CURRICULUM).curriculum)

    def levels(progress: float | None) -> set[int]:
        inside = environment if progress is None else environment.at_progress(jnp.float32(progress))
        return set((np.asarray(started(inside, 8).info["layout"]) // 2).tolist())

    assert levels(None) == levels(1.0) == {NUM_LEVELS - 1}
    assert levels(0.0) == {0}
    assert levels(0.99) == {NUM_LEVELS - 2}
    assert levels(7.0) == {NUM_LEVELS - 1}


@pytest.mark.extra
def test_the_target_velocity_of_an_episode_is_that_of_its_level() -> None:
    begins = {"start": {"target_velocity": 0.5}, "over_steps": 1000}
    task = {"target_velocity": 2.0, "num_layouts": 2}
    environment = built(**task, curriculum=options(**task, curriculum=begins).curriculum)

    def worth(progress: float) -> float:
        """Of a step at some 0.4 m/s."""
        state = jax.tree.map(lambda x: x[0], started(environment.at_progress(jnp.float32(progress)), 1))
        physics = replace(state.physics, qvel=state.physics.qvel.at[0].set(0.5))
        after = jax.jit(environment.step)(replace(state, physics=physics), jnp.zeros(8))
        speed, reward = (float(after.metrics[name]) for name in ("x_velocity", "reward_target_velocity"))
        assert 0.2 < speed < 0.5
        return reward / speed

    # Below the target v* a speed v is worth v / v*. At level 5 of 15 the target is 0.5 + 1.5 / 3.
    assert [worth(p) for p in (0.0, 1 / 3 + 1e-3, 1.0)] == pytest.approx(
        [1 / 0.5, 1 / 1.0, 1 / 2.0], rel=1e-5
    )


@pytest.mark.extra
def test_a_rollout_keeps_the_arena_of_each_episode() -> None:
    environment = built(num_layouts=3)
    episodes = rollout(
        environment, zero_policy(8), key=jax.random.key(1), num_steps=2, num_episodes=4
    ).episodes
    assert len({episode.arena["geom_pos"].tobytes() for episode in episodes}) > 1
    assert (
        not rollout(built(), zero_policy(8), key=jax.random.key(1), num_steps=1, num_episodes=1)
        .episodes[0]
        .arena
    )


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"num_layouts": 0}, "num_layouts: Input should be greater than or equal to 1"),
        ({"num_layouts": 2, "arena_seed": 2**32 - 1}, "the last layout would have the seed 4294967296"),
        ({"arena": "empty", "num_layouts": 2}, "the arena 'empty' has nothing to lay out"),
        (
            {"curriculum": {"start": {"gap_length": [-1, 0]}, "over_steps": 5}},
            "gap_length: must not be negative",
        ),
        (
            {"curriculum": {"start": {"gap_length": [0.1, 0.2]}, "over_steps": 0}},
            "over_steps: Input should be gr",
        ),
        (
            {"curriculum": {"start": {}, "over_steps": 5}},
            "curriculum.start must have platform_length or gap_length",
        ),
        (
            {"curriculum": {"start": {"wall_gap": [1, 2]}, "over_steps": 5}},
            "has wall_gap, which the arena 'gaps'",
        ),
        (
            {"curriculum": {"start": {"platform_length": [0, 1]}, "over_steps": 5}},
            "as the curriculum begins, platform_length must be above 0",
        ),
        ({"curriculum": {"start": {"gravity": 3}, "over_steps": 5}}, "curriculum.start.gravity"),
        (
            {"curriculum": {"start": {"target_velocity": 1.0}, "over_steps": 5}},
            "curriculum.start has target_velocity, so the option itself must not be null",
        ),
        (
            {"target_velocity": 2.0, "curriculum": {"start": {"target_velocity": 0.0}, "over_steps": 5}},
            "as the curriculum begins, Input should be greater than 0",
        ),
    ],
)
def test_what_cannot_be_laid_out_is_refused(changed: dict[str, Any], sentence: str) -> None:
    assert sentence in refusal(**changed)
