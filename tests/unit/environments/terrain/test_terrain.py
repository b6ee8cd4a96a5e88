"""A task with a terrain, on the probe of users' models: a ball with an arm over a floor."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from core.environments import catalog
from core.environments.environment import State
from core.environments.mjcf.check import problems
from core.environments.mjcf.edit_check import edited
from core.environments.mjcf.edit_options import ModelEdits
from core.environments.mjcf.info import MjcfOptions
from core.environments.task import TaskEnv
from core.environments.terms.describe import inventory
from core.environments.terrain.layouts import NUM_VARIANTS
from core.environments.wrappers.terrain_levels import cells_of_pool, chosen_starts
from core.errors import Rejected
from tests.unit.environments.mjcf.probe import KEY, MODEL, XML, build
from tests.unit.environments.mjcf.test_environment import NO_TORQUE, moving
from tests.unit.environments.test_simulation import check

HARD: dict[str, Any] = {"levels": [9, 9], "curriculum": False}


def on(folder: Path, kind: str, **options: Any) -> TaskEnv:
    environment = build(folder, terrain={"kinds": [kind], **HARD}, **options)
    assert isinstance(environment, TaskEnv)
    return environment


def test_a_robot_begins_on_the_ground_of_its_episode(tmp_path: Path) -> None:
    environment = build(tmp_path, terrain={"kinds": ["flat", "gaps"]})
    states = jax.jit(jax.vmap(environment.reset))(jax.random.split(KEY, 40))
    cells = states.info["terrain"] // NUM_VARIANTS
    # Ten levels of flat ground, and ten with gaps of 1 m; the ball begins 0.5 m above either.
    np.testing.assert_allclose(states.physics.qpos[:, 2], np.where(cells < 10, 0.5, 1.5), atol=1e-5)
    assert set((cells // 10).tolist()) == {0, 1}
    np.testing.assert_array_equal(states.metrics["terrain_level"], np.zeros(40))  # An episode begins.


def test_the_ball_lands_on_its_own_stairs(tmp_path: Path) -> None:
    xml = XML.replace(b'gravity="0 0 0"', b'gravity="0 0 -9.81"')
    environment = build(tmp_path, xml=xml, terrain={"kinds": ["stairs_down"], **HARD}, termination=[])
    state, step = environment.reset(KEY), jax.jit(environment.step)
    for _ in range(60):
        state = step(state, NO_TORQUE)
    # Five steps of 15 cm above the floor, and its radius.
    assert float(state.physics.qpos[2]) == pytest.approx(0.75 + 0.1, abs=0.01)
    assert float(state.metrics["terrain_level"]) == 9.0


def after(environment: TaskEnv, x: float, z: float, yaw: float = 0.0) -> State:
    """The state a step after the ball was put there."""
    turned = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
    state = moving(environment.reset(KEY), qpos=[x, 0, z, *turned, 0], qvel=[0] * 7)
    return jax.jit(environment.step)(state, NO_TORQUE)


def test_heights_count_from_the_ground_below(tmp_path: Path) -> None:
    environment = on(tmp_path, "stairs_up", termination=[{"kind": "height_range", "range": [0.4, 2.0]}])
    # On the second step, at 0.3 m.
    assert float(after(environment, 1.2, 0.8).done) == 0.0
    assert float(after(environment, 1.2, 0.6).done) == 1.0


@pytest.mark.parametrize("end", [{"kind": "fell_into_hole"}, {"kind": "height_range", "range": [0.1, 1.0]}])
def test_an_episode_ends_in_a_hole(tmp_path: Path, end: dict[str, Any]) -> None:
    environment = on(tmp_path, "gaps", termination=[end])
    # The gap begins at 0.75 m, and is 1 m deep: above it, the ground about it counts.
    assert float(after(environment, 0.9, 1.4).done) == 0.0
    assert float(after(environment, 0.9, 0.9).done) == 1.0


def test_a_scan_turns_with_the_root(tmp_path: Path) -> None:
    scan = {"kind": "height_scan", "length": 1.0, "width": 0.0, "spacing": 1.0, "clip": None}
    environment = on(tmp_path, "slope_up", observation=[scan], termination=[])
    # Points 0.5 m behind and before x = 1.75 m, on a slope of 20 degrees that begins at 0.75 m; the root is
    # 0.2 m above its height in the pose, which is 0.5 m.
    rise = np.tan(np.radians(20))
    assert np.asarray(after(environment, 1.75, 0.7).obs) == pytest.approx(
        [0.2 - 0.5 * rise, 0.2 - 1.5 * rise], abs=1e-4
    )
    backwards = after(environment, 1.75, 0.7, yaw=np.pi).obs
    assert np.asarray(backwards) == pytest.approx([0.2 - 1.5 * rise, 0.2 - 0.5 * rise], abs=1e-4)


def test_a_scan_of_a_plane_is_the_roots_height(tmp_path: Path) -> None:
    environment = build(tmp_path, observation=[{"kind": "height_scan"}], termination=[])
    assert isinstance(environment, TaskEnv)
    np.testing.assert_allclose(after(environment, 3.0, 0.9).obs, np.full(35, 0.4), atol=1e-5)


# Of three levels, those of stairs up begin at the cell 3.
LEVELS = {"kinds": ["flat", "stairs_up"], "levels": [2, 4]}


@pytest.mark.parametrize(
    ("level", "walked", "fell", "follows"),
    [
        # [distance, way along commands, way asked for] in m.
        (0, [3.1, 4.0, 5.0], 0.0, 1),
        (0, [2.9, 4.0, 5.0], 0.0, 0),
        (1, [2.9, 2.4, 5.0], 0.0, 0),
        (1, [2.9, 4.0, 5.0], 1.0, 0),
        (0, [0.0, 0.0, 5.0], 1.0, 0),
        (1, [0.0, 0.0, 0.0], 0.0, 1),  # It was to stand.
        (2, [3.1, 0.0, 5.0], 1.0, 7 % 3),  # From the highest level to any.
    ],
)
def test_an_environment_goes_up_and_down_by_how_far_it_walked(
    tmp_path: Path, level: int, walked: list[float], fell: float, follows: int
) -> None:
    environment = build(tmp_path, terrain=LEVELS)
    assert isinstance(environment, TaskEnv)
    begun = environment.at_terrain_cell(jnp.int32(3 + level)).reset(KEY)
    ended = replace(begun, info={**begun.info, "walked": jnp.array(walked)}, done=jnp.float32(fell))
    grid = environment.terrain_levels
    assert grid is not None
    assert int(grid.next_cell(ended, jnp.int32(7))) == 3 + follows
    # A pool of as many starts as asked for, and a few more, has two of each cell.
    cells = cells_of_pool(environment, 8)
    assert cells is not None
    several = jax.tree.map(lambda x: x[None], ended)
    chosen = chosen_starts(environment, several, jnp.array([7 * 2 + 1]), len(cells))
    assert [int(cells[chosen[0]]), int(chosen[0]) % 2] == [3 + follows, 1]


def test_environments_begin_at_any_of_the_lower_levels(tmp_path: Path) -> None:
    environment = build(tmp_path, terrain=LEVELS)
    assert isinstance(environment, TaskEnv)
    assert environment.terrain_levels is not None
    cells = environment.terrain_levels.first_cells(KEY, 100)
    assert set(cells.tolist()) == {0, 1, 3, 4}


def test_a_simulation_has_each_level_of_each_kind(tmp_path: Path) -> None:
    xml = XML.replace(b'gravity="0 0 0"', b'gravity="0 0 -9.81"')
    environment = build(
        tmp_path,
        xml=xml,
        terrain={"kinds": ["flat", "stairs_down"], "levels": [8, 9]},
        # It begins 2 cm above the platform, which is 0.75 m from the start at most, or beside it.
        reset={"qpos": [0, 0, 0.12, 1, 0, 0, 0, 0], "pose": {"x": [-1.4, 1.4], "y": [-0.5, 0.5]}},
        observation=[{"kind": "height_scan"}, {"kind": "qpos"}, {"kind": "qvel"}],
        termination=[{"kind": "height_range", "range": [0.0, 0.3]}],
    )
    assert isinstance(environment, TaskEnv)
    check(environment)
    terrain = environment.simulation().terrain
    assert terrain is not None
    # The ground of stairs of 2 to 15 cm is five of them high.
    assert [(one.kind, one.level, pytest.approx(one.lift)) for one in terrain.layouts] == [
        ("flat", 8, 0.0),
        ("flat", 9, 0.0),
        ("stairs_down", 8, 5 * (0.02 + 0.13 * 8 / 9)),
        ("stairs_down", 9, 0.75),
    ]
    heights = [start.qpos[2] for start in environment.simulation().starts]
    assert heights == pytest.approx([0.12] * len(heights), abs=0.011)  # Less or more the noise.


@pytest.mark.parametrize(
    ("terrain", "place", "sentence"),
    [
        ({"kinds": ["lava"]}, "terrain/kinds/0", "Input should be 'flat'"),
        ({"kinds": ["gaps", "gaps"]}, "terrain/kinds", "twice"),
        ({"levels": [5, 2]}, "terrain/levels", "low ≤ high"),
        ({"levels": [0, 10]}, "terrain/levels/1", "less than 10"),
        ({"stair_height": [0.2, 0.1]}, "terrain/stair_height", "low ≤ high"),
        ({"slope": [0, 80]}, "terrain/slope/1", "less than or equal to 40"),
    ],
)
def test_a_terrain_that_is_none_is_refused(terrain: dict[str, Any], place: str, sentence: str) -> None:
    with pytest.raises(Rejected, match=sentence) as refused:
        catalog.parse_options(catalog.find("go1"), {"terrain": terrain})
    assert refused.value.problems[0].pointer == f"/environment/options/{place}"


def refusals(xml: bytes, **options: Any) -> list[tuple[str, str]]:
    import mujoco

    given = MjcfOptions.model_validate({"model": MODEL, **options})
    parts = edited(inventory(mujoco.MjModel.from_xml_string(xml)), given.edits)
    return [(one.pointer.removeprefix("/environment/options/"), one.detail) for one in problems(given, parts)]


def test_a_model_without_room_for_a_terrain_is_refused() -> None:
    floor = b'<geom name="floor" type="plane" size="5 5 1"/>'
    assert refusals(XML, terrain={}) == []
    slides = XML.replace(b'<freejoint name="root"/>', b'<joint type="slide"/>')
    [(place, detail)] = refusals(slides.replace(b"0 0 0.8 1 0 0 0 0.5", b"0 0.5"), terrain={})
    assert (place, "free joint" in detail) == ("terrain", True)
    for ground in (b"", floor + b'<geom name="rock" size="0.1"/>', floor.replace(b"/>", b' euler="5 0 0"/>')):
        [(place, detail)] = refusals(XML.replace(floor, ground), terrain={})
        assert (place, "level plane" in detail) == ("terrain", True)
    assert refusals(XML.replace(floor, b""), terrain={}, edits=ModelEdits(floor=True)) == []
    [(place, detail)] = refusals(XML, termination=[{"kind": "fell_into_hole"}])
    assert (place, detail) == ("termination/0", "The term fell_into_hole needs a `terrain`.")
