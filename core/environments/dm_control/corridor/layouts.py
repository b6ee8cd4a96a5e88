"""Many layouts of one corridor: the lengths of each, and the fields of the model that hold them.

Layout i of `arena_seed` s has the lengths that dm_control draws from seed s + i. With a curriculum each
layout has several levels: the same draws, between bounds that go from the curriculum's to the options' own.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import copysign
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

from core.environments.dm_control.corridor.curriculum import at_every_level
from core.environments.dm_control.corridor.info import FIRST_PLATFORM_M, CorridorOptions
from core.physics.engine import ModelFields

Floats = NDArray[np.float32]
Boxes = NDArray[np.float64]
_Draw = Callable[[tuple[float, float]], float]

# dm_control's: half the height of a platform and the thickness of a wall, and the padding at both ends.
_THICKNESS_M, _PADDING_M = 0.16, 2.0
# Platforms that are nearer than this touch each other.
_SEAM_M = 1e-6
# Boxes that a layout has no use for are behind its end, so far from each other.
_OUT_OF_REACH_M = 100.0


class Obstacle(NamedTuple):
    """A gap or a wall. begin, end: its extent in x; y: the middle of the way past it, 0 for a gap; all in
    metres."""

    begin: float
    end: float
    y: float


@dataclass(frozen=True)
class Layouts:
    """Every layout at every level: first axis levels × layouts, a level's layouts side by side.

    boxes: [.., most, 2, 3], see `boxes_of`. obstacles: [.., most obstacles + 1, 3], each as `Obstacle`; those
    that a layout does not have are infinitely far. largest: the options, with their seed, of a layout that
    has all boxes.
    """

    num_layouts: int
    num_levels: int
    boxes: Boxes
    obstacles: Floats
    largest: CorridorOptions

    def fields(self, model: mujoco.MjModel) -> Mapping[str, Floats]:
        """The fields of the model [.., …] that differ between layouts."""
        numbers = [index for index in range(model.ngeom) if is_box(model.geom(index).name)]
        every = {
            name: np.repeat(np.asarray(getattr(model, name), np.float32)[None], len(self.boxes), axis=0)
            for name in ("geom_pos", "geom_size", "geom_rbound", "geom_aabb")
        }
        places, sizes = self.boxes[:, :, 0], self.boxes[:, :, 1]
        every["geom_pos"][:, numbers] = places
        every["geom_size"][:, numbers] = sizes
        every["geom_rbound"][:, numbers] = np.linalg.norm(sizes, axis=-1)
        every["geom_aabb"][:, numbers, 3:] = sizes
        return every


def draw_layouts(options: CorridorOptions) -> Layouts:
    """All layouts of the options, at all levels if they have a curriculum."""
    levels = at_every_level(options, options.curriculum)
    chosen = [
        at_this_level.model_copy(update={"arena_seed": options.arena_seed + number})
        for at_this_level in levels
        for number in range(options.num_layouts)
    ]
    drawn = [boxes_of(one, one.arena_seed) for one in chosen]
    most = max(range(len(drawn)), key=lambda index: len(drawn[index]))
    obstacles = [obstacles_among(boxes, options.arena) for boxes in drawn]
    return Layouts(
        num_layouts=options.num_layouts,
        num_levels=len(levels),
        boxes=np.stack([_filled(boxes, drawn[most]) for boxes in drawn]),
        obstacles=_padded(obstacles),
        largest=chosen[most],
    )


def boxes_of(options: CorridorOptions, seed: int) -> Boxes:
    """The platforms or walls of a layout [number, 2, 3]: the `geom_pos` and `geom_size` of each.

    The lengths are dm_control's for this seed. The last platform reaches to the wall at the end.
    """
    random = np.random.RandomState(seed)

    def draw(bounds: tuple[float, float]) -> float:
        return float(random.uniform(*bounds))

    rows = list(_platforms(options, draw) if options.arena == "gaps" else _walls(options, draw))
    return np.array(rows, float).reshape(-1, 2, 3)


def _platforms(options: CorridorOptions, draw: _Draw) -> Iterator[list[list[float]]]:
    extents, x = [(0.0, FIRST_PLATFORM_M)], FIRST_PLATFORM_M
    while x < options.corridor_length:
        extents.append((x, x + draw(options.platform_length)))
        x = extents[-1][1] + draw(options.gap_length)
    begin, end = extents[-1]
    extents[-1] = begin, max(end, options.corridor_length + _PADDING_M)
    for begin, end in extents:
        yield [
            [(begin + end) / 2, 0.0, -_THICKNESS_M],
            [(end - begin) / 2, options.corridor_width / 2, _THICKNESS_M],
        ]


def _walls(options: CorridorOptions, draw: _Draw) -> Iterator[list[list[float]]]:
    height, side = options.wall_height / 2, 1.0
    x = draw(options.wall_gap) + _PADDING_M
    while x < options.corridor_length:
        width = draw(options.wall_width)
        yield [
            [x, side * (options.corridor_width - width) / 2, height],
            [_THICKNESS_M / 2, width / 2, height],
        ]
        x, side = x + draw(options.wall_gap), -side


def is_box(name: str) -> bool:
    """Whether dm_control's geom of this name is a platform or a wall."""
    return name.startswith(("start_floor", "floor_", "wall_"))


def obstacles_among(boxes: Boxes, arena: str) -> list[Obstacle]:
    """The gaps between platforms, or the walls [number, 2, 3], in the order of their ends."""
    extents = [(float(place[0] - size[0]), float(place[0] + size[0])) for place, size in boxes]
    if arena == "walls":
        # A wall reaches 2 size[1] in from one side, so the middle of what it leaves is size[1] from the axis.
        sides = [-copysign(size[1], place[1]) for place, size in boxes]
        found = [Obstacle(*extent, y) for extent, y in zip(extents, sides, strict=True)]
    else:
        # Between the first platform and the second there is no gap.
        gaps = [(end, begin) for (_, end), (begin, _) in pairwise(sorted(extents))]
        found = [Obstacle(begin, end, 0.0) for begin, end in gaps if end - begin > _SEAM_M]
    return sorted(found, key=lambda one: one.end)


def _filled(boxes: Boxes, largest: Boxes) -> Boxes:
    """The boxes, and as many copies of the largest layout's last as they lack, out of reach."""
    missing = largest[len(boxes) :].copy()
    missing[:] = largest[-1:]
    missing[:, 0, 0] += _OUT_OF_REACH_M * np.arange(1, len(missing) + 1)
    return np.concatenate([boxes, missing])


def _padded(obstacles: Sequence[Sequence[Obstacle]]) -> Floats:
    most = max(len(own) for own in obstacles) + 1
    rows = np.tile(np.array([np.inf, np.inf, 0.0], np.float32), (len(obstacles), most, 1))
    for row, own in zip(rows, obstacles, strict=True):
        row[: len(own)] = np.array(own, np.float32).reshape(-1, 3)
    return rows


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
