"""Environments that go up and down the levels of a terrain by how far they walk.

A terrain is a grid of cells: a level of a kind of ground. An environment's cell follows from its last episode
alone, and its next start is one of that cell: what a checkpoint holds of the running episodes is enough to
continue.
Source: Rudin et al., Learning to Walk in Minutes Using Massively Parallel Deep RL (2022), "game-inspired
curriculum".
"""

from typing import Protocol, cast, runtime_checkable

import jax
import jax.numpy as jnp

from core.environments.environment import Environment, State, innermost, with_innermost
from core.environments.terrain.grid import TerrainGrid


@runtime_checkable
class HasTerrainLevels(Protocol):
    """The attributes of an environment besides its own methods."""

    @property
    def terrain_levels(self) -> TerrainGrid | None:
        """None: no start depends on the last episode."""
        ...

    def at_terrain_cell(self, cell: jax.Array) -> Environment:
        """The environment whose fresh starts are in this cell [] int32; without this call, in any."""
        ...


def terrain_levels(environment: Environment) -> TerrainGrid | None:
    """None if no fresh start depends on the last episode."""
    inner = innermost(environment)
    return inner.terrain_levels if isinstance(inner, HasTerrainLevels) else None


def at_cell(environment: Environment, cell: jax.Array) -> Environment:
    """The environment whose fresh starts are in this cell."""
    return with_innermost(environment, lambda inner: cast("HasTerrainLevels", inner).at_terrain_cell(cell))


def first_cells(environment: Environment, key: jax.Array, number: int) -> jax.Array | None:
    """The cells [number] of an algorithm's first starts; None if there are none."""
    grid = terrain_levels(environment)
    return None if grid is None else grid.first_cells(jax.random.fold_in(key, _OF_CELLS), number)


def cells_of_pool(environment: Environment, size: int) -> jax.Array | None:
    """The cells of the starts of a pool of `size` starts, or of a few more: as many of each; None if there
    are none."""
    grid = terrain_levels(environment)
    return None if grid is None else jnp.repeat(jnp.arange(grid.num_cells), -(-size // grid.num_cells))


def chosen_starts(environment: Environment, state: State, chosen: jax.Array, pool_size: int) -> jax.Array:
    """Which starts of a pool follow if episodes end in these states [N, ...], [N] int32.

    chosen: random numbers [N] int32. pool_size: of a pool that has the cells of `cells_of_pool`. Without
    cells, it is those that were chosen.
    """
    grid = terrain_levels(environment)
    if grid is None:
        return chosen
    of_a_cell = pool_size // grid.num_cells
    cells = jax.vmap(grid.next_cell)(state, chosen // of_a_cell)
    return cells * of_a_cell + chosen % of_a_cell


# Folded into a key that other random numbers are drawn from, too.
_OF_CELLS = 0x7E44
