"""The layout that an environment has: which one a fresh start takes, and what lies ahead in it."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.dm_control.corridor.layouts import Boxes, Layouts, Obstacle
from core.physics.engine import ModelFields

# The entry of `State.info`: [] int32, which of the layouts at which level.
LAYOUT = "layout"
# Folded into a start's key, so that it draws a layout beside what it draws anyway.
_OF_LAYOUTS = 0x1A70


class OneCourse:
    """The corridor of the model, in every episode. boxes: as `boxes_of` has them; start_x: where a walker
    begins; end: of the corridor; in m."""

    def __init__(self, boxes: Boxes, obstacles: list[Obstacle], start_x: float, end: float) -> None:
        self._boxes = jnp.asarray(boxes, jnp.float32)
        self._obstacles = jnp.reshape(jnp.asarray(obstacles, jnp.float32), (-1, 3))
        self._start, self._finish = start_x, max((one.end for one in obstacles), default=end)

    def draw(
        self, key: jax.Array, progress: jax.Array | float
    ) -> tuple[ModelFields, Mapping[str, jax.Array]]:
        """Fields of the model and the entries of `State.info` for a fresh start with this key."""
        return {}, {}

    def level(self, info: Mapping[str, jax.Array]) -> jax.Array:
        """The level of the curriculum at which the episode began, [] int32; 0 without a curriculum."""
        return jnp.int32(0)

    def obstacles(self, info: Mapping[str, jax.Array]) -> jax.Array:
        """[number, 3], each as `Obstacle`, in the order of their ends."""
        return self._obstacles

    def boxes(self, info: Mapping[str, jax.Array]) -> jax.Array:
        """[number, 2, 3]: the middle and half lengths of each platform or wall."""
        return self._boxes

    def passed(self, info: Mapping[str, jax.Array], x: jax.Array) -> jax.Array:
        """Which part of the way from the start past the last obstacle is behind x, from 0 to 1; []."""
        return _part(self._start, self._finish, x)


class ManyCourses:
    """One of many layouts, for an episode: any of the level that the progress has reached."""

    def __init__(self, layouts: Layouts, model: mujoco.MjModel, start_x: float, end: float) -> None:
        self._layouts, self._start = layouts, start_x
        self._fields = {name: jnp.asarray(values) for name, values in layouts.fields(model).items()}
        self._obstacles = jnp.asarray(layouts.obstacles)
        self._boxes = jnp.asarray(layouts.boxes, jnp.float32)
        ends = np.where(np.isfinite(layouts.obstacles[:, :, 1]), layouts.obstacles[:, :, 1], 0.0).max(axis=1)
        self._finish = jnp.asarray(np.where(ends > 0, ends, end), jnp.float32)

    def draw(
        self, key: jax.Array, progress: jax.Array | float
    ) -> tuple[ModelFields, Mapping[str, jax.Array]]:
        number = jax.random.randint(jax.random.fold_in(key, _OF_LAYOUTS), (), 0, self._layouts.num_layouts)
        level = jnp.floor(jnp.clip(progress, 0.0, 1.0) * (self._layouts.num_levels - 1)).astype(jnp.int32)
        chosen = level * self._layouts.num_layouts + number
        return {name: values[chosen] for name, values in self._fields.items()}, {LAYOUT: chosen}

    def level(self, info: Mapping[str, jax.Array]) -> jax.Array:
        return info[LAYOUT] // self._layouts.num_layouts

    def obstacles(self, info: Mapping[str, jax.Array]) -> jax.Array:
        return self._obstacles[info[LAYOUT]]

    def boxes(self, info: Mapping[str, jax.Array]) -> jax.Array:
        return self._boxes[info[LAYOUT]]

    def passed(self, info: Mapping[str, jax.Array], x: jax.Array) -> jax.Array:
        return _part(self._start, self._finish[info[LAYOUT]], x)


def _part(start: float, finish: float | jax.Array, x: jax.Array) -> jax.Array:
    return jnp.clip((x - start) / (finish - start), 0.0, 1.0)
