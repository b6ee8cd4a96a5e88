"""The walker's own camera: distances as MuJoCo's own rays find them."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from core.environments import catalog
from core.environments.dm_control.corridor.egocentric import CAMERA, along
from core.environments.dm_control.corridor.environment import Corridor
from core.environments.dm_control.corridor.info import SIGHT_M, CorridorOptions
from core.errors import Rejected
from core.physics.choose import engine_builder
from tests.extra import extra

_SIDE = 12
_ARENAS: list[dict[str, Any]] = [
    {"walker": "ant", "arena": "gaps", "gap_length": (0.2, 0.5)},
    {"walker": "ant", "arena": "walls"},
    {"walker": "ant", "arena": "empty"},
    {"walker": "rodent", "arena": "gaps", "start_x": 5.8},
    {"walker": "humanoid", "arena": "walls"},
]


def test_a_ray_meets_the_first_box_on_its_way() -> None:
    boxes = jnp.array([[[4.0, 0.0, 0.0], [1.0, 1.0, 1.0]], [[9.0, 0.0, 0.0], [1.0, 9.0, 1.0]]])
    eye = jnp.zeros(3)
    rays = jnp.array(
        [
            [1.0, 0.0, 0.0],  # Its near side is 3 m ahead.
            [2.0, 0.0, 0.0],  # Twice as long a ray goes 1.5 times its length.
            [1.0, 0.5, 0.0],  # Past the first box, to the second's side 8 m ahead.
            [-1.0, 0.0, 0.0],  # Nothing is behind it.
            [0.0, 0.0, 1.0],
        ]
    )
    np.testing.assert_allclose(along(eye, rays, boxes), [3.0, 1.5, 8.0, np.inf, np.inf])
    np.testing.assert_allclose(along(jnp.array([4.0, 0.5, 0.0]), rays, boxes), 0.0)
    assert np.isinf(along(eye, rays, jnp.zeros((0, 2, 3)))).all()


@pytest.mark.parametrize(
    "options",
    [_ARENAS[0], *extra(*_ARENAS[1:])],
    ids=lambda options: f"{options['walker']}-{options['arena']}",
)
def test_each_pixel_has_the_depth_that_mujocos_rays_find(options: dict[str, Any]) -> None:
    environment = _built(**options)
    image, data = _image(environment, turned=jax.random.key(5))
    assert image.min() >= 0
    assert image.max() == SIGHT_M
    assert len(np.unique(image)) > 5
    np.testing.assert_allclose(image, _by_rays(environment.model, data), atol=2e-3)


@pytest.mark.extra
def test_an_episode_sees_its_own_layout() -> None:
    options: dict[str, Any] = {"arena": "walls", "wall_gap": (4.0, 8.0), "reset_noise_scale": 0.0}
    many = _built(num_layouts=2, **options)
    states = jax.jit(jax.vmap(many.reset))(jax.random.split(jax.random.key(0), 4))
    images = np.asarray(states.obs[:, -(_SIDE**2) :])
    assert len(np.unique(images, axis=0)) == 2
    drawn = np.asarray(states.info["layout"])
    for layout in (0, 1):
        alone, _ = _image(_built(arena_seed=123456 + layout, **options), turned=None)
        for image in images[drawn == layout]:
            np.testing.assert_allclose(image.reshape(_SIDE, _SIDE), alone, atol=1e-4)


def test_an_image_too_large_is_refused() -> None:
    with pytest.raises(Rejected, match="egocentric_depth"):
        catalog.parse_options(catalog.find("corridor"), {"egocentric_depth": 65})


def _built(**options: Any) -> Corridor:
    return Corridor(CorridorOptions(egocentric_depth=_SIDE, **options), engine_builder("native"))


def _image(environment: Corridor, turned: jax.Array | None) -> tuple[np.ndarray, mujoco.MjData]:
    """The image [side, side] at the start, and MuJoCo's data there. turned: a key to turn the walker by."""
    qpos = environment.initial_qpos
    if turned is not None:
        aside = 0.1 * jax.random.normal(turned, (4,)) + jnp.array([0.0, 0.0, 0.0, 0.3])
        quaternion = qpos[3:7] + aside
        qpos = qpos.at[3:7].set(quaternion / jnp.linalg.norm(quaternion)).at[2].add(0.1)
    state = jax.jit(environment.reset)(jax.random.key(0))
    physics = jax.jit(environment.engine.reset)(qpos, jnp.zeros(environment.model.nv))
    assert environment._camera is not None
    image = environment._camera(physics, environment._course.boxes(state.info))
    data = mujoco.MjData(environment.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(environment.model, data)
    return np.asarray(image).reshape(_SIDE, _SIDE), data


def _by_rays(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """The depths [side, side] of the arena by `mj_ray`, from the pose that MuJoCo gives the camera."""
    eye, axes = data.camera(CAMERA).xpos, data.camera(CAMERA).xmat.reshape(3, 3)
    _hide_the_walker(model)
    drawn = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    half = np.tan(np.radians(model.camera(CAMERA).fovy[0]) / 2)
    depths = np.full((_SIDE, _SIDE), SIGHT_M)
    for row in range(_SIDE):
        for column in range(_SIDE):
            right, up = ((column + 0.5) * 2 / _SIDE - 1) * half, (1 - (row + 0.5) * 2 / _SIDE) * half
            ray = axes @ np.array([right, up, -1.0])
            met = np.full(1, -1, np.int32)
            depth = mujoco.mj_ray(model, data, eye, ray, drawn, 1, -1, met)
            if met[0] >= 0:
                depths[row, column] = min(depth, SIGHT_M)
    return depths


def _hide_the_walker(model: mujoco.MjModel) -> None:
    for number in range(model.ngeom):
        geom = model.geom(number)
        if model.body(int(geom.bodyid[0])).name.startswith("walker/"):
            geom.group = 5
