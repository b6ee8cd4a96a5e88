"""The brittle star's tasks. Rewards and observables as in biorobot's environments of the same names."""

from collections.abc import Mapping
from typing import Protocol

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from core.environments.brittle_star.light import light_at, light_map
from core.environments.brittle_star.options import DISK, TARGET_RADIUS_M, DirectedOptions, LightEscapeOptions
from core.physics.engine import PhysicsState

Named = Mapping[str, jax.Array]
_TARGET_HEIGHT_M = 0.05


@struct.dataclass
class Measured:
    """What a task measures in a state. potential: []; a step's reward is its growth.

    done: [], 1 where the task is done. observables: arrays [n] by biorobot's names. info, metrics: what the
    task adds to a State's.
    """

    potential: jax.Array
    done: jax.Array
    observables: Named
    info: Named
    metrics: Named


class Task(Protocol):
    @property
    def derived(self) -> tuple[str, ...]:
        """The fields that `measure` reads."""
        ...

    def draw(self, key: jax.Array) -> Named:
        """What stays the same for an episode; it is kept in the State's info."""
        ...

    def measure(self, physics: PhysicsState, drawn: Named) -> Measured: ...


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

    def measure(self, physics: PhysicsState, drawn: Named) -> Measured:
        way = drawn["target_position"][:2] - physics.qpos[:2]
        distance = jnp.linalg.norm(way)
        direction = way / jnp.maximum(distance, 1e-9)
        reached = jnp.where(distance < TARGET_RADIUS_M, 1.0, 0.0)
        return Measured(
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

    def measure(self, physics: PhysicsState, drawn: Named) -> Measured:
        distance = jnp.linalg.norm(physics.qpos[:2])
        return Measured(distance, jnp.zeros(()), {}, {}, {})


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

    def measure(self, physics: PhysicsState, drawn: Named) -> Measured:
        segments = physics.derived["geom_xpos"][self._capsules, :2]
        points = jnp.concatenate([segments, physics.qpos[None, :2]])
        light = light_at(jnp.asarray(self.light_map), self._half_lengths, points)
        income = jnp.dot(self._shares, light)
        return Measured(
            potential=-income,
            done=jnp.zeros(()),
            observables={"segment_light_intake": light[:-1], "disk_light_intake": light[-1:]},
            info={},
            metrics={
                "light_income": income,
                "x_distance_travelled": physics.qpos[0] - self._start_x,
            },
        )
