"""Where a terrain's boxes are: by hand, and beside MuJoCo's rays."""

from math import radians, tan
from typing import get_args

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments.terms.terrain import MOST_BOXES, Ground, Kind, Terrain
from core.environments.terrain.layouts import Layout, layout, num_boxes
from core.environments.terrain.model import add_boxes, boxes_of

KINDS: tuple[Kind, ...] = get_args(Kind)
EVERY = Terrain(kinds=list(KINDS))
FLOOR = '<mujoco><worldbody><geom name="floor" type="plane" size="9 9 1"/></worldbody></mujoco>'


def height(boxes: Layout, *points: tuple[float, float]) -> list[float]:
    ground = Ground(boxes.tops(), np.array(boxes.lowest))
    return ground.height(np.array(points), np).tolist()


@pytest.mark.parametrize(
    ("kind", "level", "points", "heights"),
    [
        ("flat", 9, [(0, 0), (2, 1)], [0, 0]),
        # Five steps of 15 cm, each 0.3 m long, after a platform of 0.75 m; the last one goes on.
        ("stairs_up", 9, [(0, 0), (0.9, 0), (0, -1.2), (1.6, 1.6), (-9, 3)], [0, 0.15, 0.3, 0.45, 0.75]),
        ("stairs_up", 0, [(0.9, 0), (9, 0)], [0.02, 0.1]),
        ("stairs_down", 9, [(0, 0), (0.9, 0), (0, 1.9), (2, 2)], [0.75, 0.6, 0.15, 0]),
        # 20 degrees from 0.75 m to 3 m, along x only.
        (
            "slope_up",
            9,
            [(0, 2), (-1.75, 2), (9, 0)],
            [0, tan(radians(20)), 2.25 * tan(radians(20))],
        ),
        ("slope_down", 9, [(0, 9), (2, 0), (4, 0)], [2.25 * tan(radians(20)), tan(radians(20)), 0]),
        # Stones of 0.3 m, 0.2 m apart, 1 m above the floor.
        ("stepping_stones", 9, [(0, 0), (0.8, 0), (0, 1.1), (-1.3, 0), (9, 9)], [1, 0, 1, 0, 1]),
        ("gaps", 9, [(0, 0), (0, 0.9), (1.5, 0), (2.2, 0), (9, 0)], [1, 0, 1, 0, 1]),
        ("pits", 9, [(0, 0), (0, 0.8)], [0, 0.3]),
    ],
)
def test_heights_are_those_of_the_options(
    kind: Kind, level: int, points: list[tuple[float, float]], heights: list[float]
) -> None:
    assert height(layout(EVERY, kind, level, 0), *points) == pytest.approx(heights, abs=1e-6)


def test_blocks_differ_and_leave_room_to_start() -> None:
    first, other = (layout(EVERY, "blocks", 9, variant) for variant in (0, 1))
    assert not np.allclose(first.places, other.places)
    np.testing.assert_array_equal(first.places, layout(EVERY, "blocks", 9, 0).places)
    grid = [(x, y) for x in (-0.4, 0.0, 0.4) for y in (-0.4, 0.0, 0.4)]
    assert height(first, *grid) == [0.0] * 9
    tops = first.tops()[:21]
    assert (tops[:, 2] > 0).all()
    assert 0.3 * 0.15 <= tops[:, 4].min() < tops[:, 4].max() <= 0.15


@pytest.mark.parametrize("kind", KINDS)
def test_the_ground_is_as_high_as_a_ray_finds_it(kind: Kind) -> None:
    terrain = Terrain(kinds=[kind])
    spec = mujoco.MjSpec.from_string(FLOOR)
    add_boxes(spec, spec.compile(), terrain)
    model = spec.compile()
    boxes = layout(terrain, kind, 7, 3)
    numbers = boxes_of(model)
    assert len(numbers) == num_boxes(terrain)
    model.geom_pos[numbers], model.geom_size[numbers] = boxes.places, boxes.sizes
    model.geom_quat[numbers] = boxes.quaternions()
    model.geom_rbound[numbers] = np.linalg.norm(boxes.sizes, axis=1)
    model.geom_sameframe[numbers] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = np.random.default_rng(0).uniform(-4, 4, (200, 2))
    down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
    found = [
        5.0 - mujoco.mj_ray(model, data, np.array([x, y, 5.0]), down, None, 1, -1, hit) for x, y in points
    ]
    ground = Ground(boxes.tops(), np.array(boxes.lowest))
    np.testing.assert_allclose(ground.height(points, np), found, atol=1e-6)
    on_the_device = ground._replace(tops=jnp.asarray(ground.tops))
    np.testing.assert_allclose(on_the_device.height(jnp.asarray(points), jnp), found, atol=1e-5)


def test_only_boxes_that_are_used_are_there() -> None:
    numbers = {kind: num_boxes(Terrain(kinds=[kind])) for kind in KINDS}
    assert numbers == {
        "flat": 0,
        "stairs_up": 21,
        "stairs_down": 17,
        "slope_up": 7,
        "slope_down": 3,
        "blocks": 21,
        "stepping_stones": 21,
        "gaps": 9,
        "pits": 5,
    }


def test_a_terrain_of_all_kinds_has_the_most_boxes() -> None:
    assert num_boxes(Terrain(kinds=list(KINDS))) == MOST_BOXES
