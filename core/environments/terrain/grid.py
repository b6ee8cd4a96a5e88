"""The terrain of each episode: a cell of a grid of kinds and levels, and which cell follows it."""

import copy
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from core.environments.environment import State
from core.environments.simulation import SimulatedLayout, SimulatedTerrain
from core.environments.terms.step import ModelIndex, Step
from core.environments.terms.terrain import Ground, Terrain
from core.environments.terrain.layouts import NUM_VARIANTS, REACH, draw_layouts
from core.environments.terrain.model import boxes_of, floor_of
from core.physics.engine import ModelFields

# The entries of `State.info`: [] int32, which layout; and [3] in m, the largest distance from the start, and
# how far the root went along its commands and how far they asked it to go.
LAYOUT, WALKED = "terrain", "walked"


class TerrainGrid:
    """The layouts of a terrain about the place where episodes begin. parts: of a model that has the terrain's
    boxes, and a root with a free joint."""

    def __init__(self, terrain: Terrain, parts: ModelIndex) -> None:
        model, self._parts = parts.model, parts
        centre = parts.pose[parts.root_position : parts.root_position + 2]
        self._layouts = draw_layouts(terrain)
        self._boxes = boxes_of(model)
        self._cell: jax.Array | None = None
        self._given: Ground | None = None
        self._nominal = {
            name: jnp.asarray(getattr(model, name), jnp.float32)
            for name in ("geom_aabb", "geom_pos", "geom_quat", "geom_rbound", "geom_size")
        }
        floor = floor_of(model)
        self._origin = np.array([*centre, model.geom_pos[floor, 2]], np.float32)
        self._kinds, self._low, self._num_levels = terrain.kinds, terrain.levels[0], terrain.num_levels
        self.num_cells = len(terrain.kinds) * terrain.num_levels
        self.has_curriculum = terrain.has_curriculum

    def at_cell(self, cell: jax.Array) -> "TerrainGrid":
        """The terrain on which episodes begin in this cell: kind × levels + level, [] int32."""
        there = copy.copy(self)
        there._cell = cell
        return there

    def begun(self, key: jax.Array) -> tuple[ModelFields, jax.Array, dict[str, jax.Array]]:
        """The fields of the model, the height of the ground at the start [] in m, and entries of
        `State.info`, of an episode that begins."""
        fields, layout, lift = self._drawn(key)
        return fields, lift, {LAYOUT: layout, WALKED: jnp.zeros(3)}

    def _drawn(self, key: jax.Array) -> tuple[ModelFields, jax.Array, jax.Array]:
        if self._given is not None:
            return {}, jnp.zeros((), jnp.int32), jnp.zeros(())
        cell_key, variant_key = jax.random.split(key)
        cell = self._cell
        if cell is None:
            cell = jax.random.randint(cell_key, (), 0, self.num_cells)
        layout = cell * NUM_VARIANTS + jax.random.randint(variant_key, (), 0, NUM_VARIANTS)
        return self._fields(layout), layout, jnp.asarray(self._layouts.lift)[layout]

    def _fields(self, layout: jax.Array) -> ModelFields:
        if not self._boxes.size:
            return {}
        rows = self._rows(layout)
        return {name: self._nominal[name].at[self._boxes].set(values) for name, values in rows.items()}

    def _rows(self, layout: jax.Array) -> ModelFields:
        """The fields of the boxes alone."""
        layouts = self._layouts
        sizes = jnp.asarray(layouts.sizes)[layout]
        return {
            "geom_pos": jnp.asarray(layouts.places + self._origin)[layout],
            "geom_size": sizes,
            "geom_rbound": jnp.linalg.norm(sizes, axis=-1),
            "geom_aabb": jnp.concatenate([jnp.zeros_like(sizes), sizes], axis=-1),
            "geom_quat": jnp.asarray(layouts.quaternions)[layout],
        }

    def ground(self, info: Mapping[str, jax.Array]) -> Ground:
        return self._ground(info[LAYOUT]) if self._given is None else self._given

    def _ground(self, layout: jax.Array) -> Ground:
        x, y, floor = self._origin
        tops = jnp.asarray(self._layouts.tops + np.array([x, y, 0, 0, floor, 0], np.float32))
        return Ground(tops[layout], jnp.asarray(self._layouts.lowest + floor)[layout])

    @property
    def ground_size(self) -> int:
        return 6 * len(self._boxes) + 1

    def given(self, ground: jax.Array) -> "TerrainGrid":
        """The terrain on which an episode has this ground, the model as it is, and the start at the floor's
        height.

        ground: [ground_size], the boxes' rows of `Ground.tops`, and `Ground.lowest`.
        """
        x, y, floor = self._origin
        there = copy.copy(self)
        plane = jnp.array([[x, y, jnp.inf, jnp.inf, floor, 0.0]], jnp.float32)
        there._given = Ground(jnp.concatenate([ground[:-1].reshape(-1, 6), plane]), ground[-1])
        return there

    def simulated(self, model: str, root_height: int) -> SimulatedTerrain:
        """The first variant of each kind and level. model: XML that has the boxes. root_height: see there."""
        cells = [(kind, self._low + level) for kind in self._kinds for level in range(self._num_levels)]
        # Beside a training that holds the accelerator.
        with jax.default_device(jax.local_devices(backend="cpu")[0]):
            layouts = NUM_VARIANTS * jnp.arange(len(cells))
            fields = {name: _numbers(rows) for name, rows in self._rows(layouts).items()}
            tops, lowest = self._ground(layouts)
            grounds = _numbers(jnp.concatenate([tops[:, :-1].reshape(len(cells), -1), lowest[:, None]], 1))
        return SimulatedTerrain(
            geoms=boxes_of(mujoco.MjModel.from_xml_string(model)).tolist(),
            nodes=self._boxes.tolist(),
            root_height=root_height,
            layouts=[
                SimulatedLayout(
                    kind,
                    level,
                    float(self._layouts.lift[cell * NUM_VARIANTS]),
                    {name: rows[cell] for name, rows in fields.items()},
                    grounds[cell],
                )
                for cell, (kind, level) in enumerate(cells)
            ],
        )

    def metrics(self, info: Mapping[str, jax.Array]) -> dict[str, jax.Array]:
        """The level of the episode, and for each level whether it is that one: their means are shares."""
        level = self._low + info[LAYOUT] // NUM_VARIANTS % self._num_levels
        levels = range(self._low, self._low + self._num_levels)
        shares = {f"terrain_level_{n}": jnp.where(level == n, 1.0, 0.0) for n in levels}
        return {"terrain_level": level.astype(jnp.float32)} | (shares if self._num_levels > 1 else {})

    def stepped(
        self, step: Step, info: Mapping[str, jax.Array], velocity: jax.Array | None
    ) -> dict[str, jax.Array]:
        """Entries of `State.info` after a step. velocity: that was commanded, forward and left in m/s first;
        None: none was."""
        here = self._parts.position(step.after, self._parts.root)[:2]
        way = asked = jnp.zeros(())
        if velocity is not None:
            speed = jnp.linalg.norm(velocity[:2])
            along = jnp.dot(self._parts.base_linear_velocity(step)[:2], velocity[:2])
            way = jnp.where(speed > 0, along / jnp.maximum(speed, 1e-6), 0.0) * step.dt
            asked = speed * step.dt
        walked, distance = info[WALKED], jnp.linalg.norm(here - self._origin[:2])
        return {WALKED: jnp.stack([jnp.maximum(walked[0], distance), walked[1] + way, walked[2] + asked])}

    def first_cells(self, key: jax.Array, number: int) -> jax.Array:
        """Where environments begin, [number] int32: all kinds, at any of the lower half of the levels."""
        kind_key, level_key = jax.random.split(key)
        kinds = jax.random.randint(kind_key, (number,), 0, self.num_cells // self._num_levels)
        levels = jax.random.randint(level_key, (number,), 0, -(-self._num_levels // 2))
        return kinds * self._num_levels + levels

    def next_cell(self, state: State, any_level: jax.Array) -> jax.Array:
        """The cell after an episode, [] int32: of the same kind. state: its last, with `done` 1 if it fell.

        An environment that walked off the terrain goes up a level, from the highest to `any_level` [] int32.
        One that fell, or went less than half as far as its commands asked, goes down.
        Source: `terrain_levels_vel` of Isaac Lab; Rudin et al., Learning to Walk in Minutes (2022).
        """
        cell = state.info[LAYOUT] // NUM_VARIANTS
        kind, level = cell // self._num_levels, cell % self._num_levels
        distance, way, asked = state.info[WALKED]
        is_up = distance > REACH
        is_down = ~is_up & ((state.done > 0) | (way < 0.5 * asked))
        level = level + is_up.astype(jnp.int32) - is_down.astype(jnp.int32)
        level = jnp.where(level >= self._num_levels, any_level % self._num_levels, jnp.maximum(level, 0))
        return kind * self._num_levels + level


def _numbers(values: jax.Array) -> list[list[float]]:
    """Those of each layout in a row, to a µm."""
    return np.round(np.asarray(values, float), 6).reshape(len(values), -1).tolist()
