"""The brittle star's tasks. Rewards and observables as in biorobot's environments of the same names."""

from collections.abc import Mapping
from importlib import import_module
from typing import Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct
from numpy.typing import NDArray

from core.environments.brittle_star.options import (
    DISK,
    LIGHT_MAP_RESOLUTION,
    TARGET_RADIUS_M,
    DirectedOptions,
    LightEscapeOptions,
)
from core.physics.engine import PhysicsState

_GROUND = "groundplane"
# The brightness of darkness in a picture, so that the star can be seen in it.
_DARKEST = 0.3


def light_map(options: LightEscapeOptions) -> NDArray[np.float32]:
    """Light in [0, 1], [rows, columns] as in a picture from above: x to the right, y up.

    It falls from 1 at the wall of least x to 0 at the opposite one. Patches, if any, become stronger with x,
    and begin behind the first fifth.
    """
    columns, rows = (LIGHT_MAP_RESOLUTION * size for size in options.arena_size)
    light = np.tile(np.linspace(1.0, 0.0, columns), (rows, 1))
    scale = options.light_perlin_noise_scale
    if scale == 0:
        return light.astype(np.float32)
    noise = import_module("biorobot.utils.noise").generate_perlin_noise_2d(
        shape=light.shape, res=(scale, scale), rng_key=options.light_seed
    )
    calm = columns // 5
    strength = np.concatenate([np.zeros(calm), np.linspace(0.0, 1.0, columns - calm)])
    light *= 1.0 + strength * (1.0 - 2.0 * noise)
    return ((light - light.min()) / np.ptp(light)).astype(np.float32)


def light_at(light: jax.Array, half_lengths: tuple[int, int], position: jax.Array) -> jax.Array:
    """The light [N] at points [N, 2] in metres, interpolated linearly between the pixels [rows, columns].

    A pixel's value is that of its corner of least x and greatest y. Beyond a wall, which arms may reach
    through, the light is that at the wall.
    """
    size = jnp.asarray(half_lengths, jnp.float32)
    across, up = jnp.moveaxis((position + size) / (2 * size), -1, 0)
    place = jnp.maximum(jnp.stack([1.0 - up, across]) * jnp.asarray(light.shape, jnp.float32)[:, None], 0.0)
    last = jnp.asarray(light.shape)[:, None] - 1
    low = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, last)
    high = jnp.minimum(low + 1, last)
    part = place - low
    above = light[low[0], low[1]] * (1 - part[1]) + light[low[0], high[1]] * part[1]
    below = light[high[0], low[1]] * (1 - part[1]) + light[high[0], high[1]] * part[1]
    return above * (1 - part[0]) + below * part[0]


def show(model: mujoco.MjModel, light: NDArray[np.float32]) -> None:
    """Paint the light on the ground of the model (changed)."""
    texture = model.texture(_GROUND)
    start, height, width = (int(number[0]) for number in (texture.adr, texture.height, texture.width))
    pixels = model.tex_data[start : start + 3 * height * width].reshape(height, width, 3)
    pixels[...] = np.round((_DARKEST + (1 - _DARKEST) * light[..., None]) * pixels)


Named = Mapping[str, jax.Array]
_TARGET_HEIGHT_M = 0.05


@struct.dataclass
class TaskMeasurement:
    """The measurements of a task in a state. potential: []; a step's reward is its growth.

    done: [], 1 where the task is done. observables: arrays [n] by biorobot's names. info, metrics: what the
    task adds to a State's.
    """

    potential: jax.Array
    done: jax.Array
    observables: Named
    info: Named
    metrics: Named


class StarTask(Protocol):
    @property
    def derived(self) -> tuple[str, ...]:
        """The fields that `measure` reads."""
        ...

    def draw(self, key: jax.Array) -> Named:
        """The values that stay the same for an episode; they are kept in the State's info."""
        ...

    def measure(self, physics: PhysicsState, drawn: Named) -> TaskMeasurement: ...


class Directed:
    """Come nearer to a target, which counts as reached at its edge. The target has no physics."""

    derived = ()

    def __init__(self, options: DirectedOptions) -> None:
        self._options = options

    def draw(self, key: jax.Array) -> Named:
        fixed = self._options.target_position
        if fixed is None:
            angle = jax.random.uniform(key, maxval=2 * jnp.pi)
            place = self._options.target_distance * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        else:
            place = jnp.asarray(fixed, jnp.float32)
        return {"target_position": jnp.append(place, _TARGET_HEIGHT_M)}

    def measure(self, physics: PhysicsState, drawn: Named) -> TaskMeasurement:
        way = drawn["target_position"][:2] - physics.qpos[:2]
        distance = jnp.linalg.norm(way)
        direction = way / jnp.maximum(distance, 1e-9)
        reached = jnp.where(distance < TARGET_RADIUS_M, 1.0, 0.0)
        return TaskMeasurement(
            potential=-distance,
            done=reached,
            observables={
                "unit_xy_direction_to_target": direction,
                "xy_distance_to_target": distance[None],
            },
            info={"xy_direction_to_target": direction, "xy_distance_to_target": distance},
            metrics={"xy_distance_to_target": distance, "target_reached": reached},
        )


class Undirected:
    """Get away from the middle of the arena."""

    derived = ()

    def draw(self, key: jax.Array) -> Named:
        return {}

    def measure(self, physics: PhysicsState, drawn: Named) -> TaskMeasurement:
        distance = jnp.linalg.norm(physics.qpos[:2])
        return TaskMeasurement(distance, jnp.zeros(()), {}, {}, {})


class LightEscape:
    """Get into the dark, with as much of the body as possible, seen from above."""

    derived = ("geom_xpos",)

    def __init__(self, options: LightEscapeOptions, model: mujoco.MjModel) -> None:
        names = [model.geom(number).name for number in range(model.ngeom)]
        self._capsules = np.array([number for number, name in enumerate(names) if name.endswith("_capsule")])
        radius, half_length = model.geom_size[self._capsules, :2].T
        disk = float(model.geom(f"{DISK}_pentagon_collider").size[0])
        # As in biorobot, each end of a capsule counts as half a disk.
        areas = np.append(np.pi * radius**2 + 4 * radius * half_length, np.pi * disk**2)
        self._shares = jnp.asarray(areas / areas.sum(), jnp.float32)
        self._half_lengths, self._start_x = options.arena_size, options.start_x
        self.light_map = light_map(options)

    def draw(self, key: jax.Array) -> Named:
        return {}

    def measure(self, physics: PhysicsState, drawn: Named) -> TaskMeasurement:
        segments = physics.derived["geom_xpos"][self._capsules, :2]
        points = jnp.concatenate([segments, physics.qpos[None, :2]])
        light = light_at(jnp.asarray(self.light_map), self._half_lengths, points)
        income = jnp.dot(self._shares, light)
        return TaskMeasurement(
            potential=-income,
            done=jnp.zeros(()),
            observables={"segment_light_intake": light[:-1], "disk_light_intake": light[-1:]},
            info={},
            metrics={
                "light_income": income,
                "x_distance_travelled": physics.qpos[0] - self._start_x,
            },
        )
