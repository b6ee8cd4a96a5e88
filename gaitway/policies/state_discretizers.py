"""From what is seen of an environment to a row of a table, or to one for each arm.

As `core.algorithms.q_learning.discrete_env`, which says what each kind is.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitway.errors import PolicyUnreadable

Seen = Mapping[str, jax.Array]
Rows = Callable[[Seen], jax.Array]


def rows_of(options: Mapping[str, Any], num_arms: int) -> Rows:
    """From arrays by name to rows [num_parts] int32: -1 where what is seen is not finite.

    options: those of the job. Raises PolicyUnreadable for a kind that this version does not know.
    """
    match options["kind"]:
        case "arm_towards_target":
            return _finite(_TARGET, lambda seen: _sector_of_target(seen, num_arms)[None])
        case "arm_role":
            return _finite(_TARGET, lambda seen: _steps_to_target(seen, num_arms))
        case "arm_side":
            return _finite(_TARGET, lambda seen: _sides_of_target(seen, num_arms))
        case "disk_position_grid":
            ranges = [options["x"], options["y"]]
            return _finite(
                ("disk_position",),
                lambda seen: _cell(seen["disk_position"][:2], ranges, options["cells"])[None],
            )
        case "observation_grid":
            components = options["components"]
            chosen, ranges, cells = (
                [component[name] for component in components] for name in ("index", "range", "cells")
            )
            places = np.asarray(chosen)
            return _finite(
                ("observation",), lambda seen: _cell(seen["observation"][places], ranges, cells)[None]
            )
        case kind:
            raise PolicyUnreadable(f"This version of gaitway has no state discretizer {kind!r}.")


_TARGET = ("disk_rotation", "xy_direction_to_target")


def _finite(names: Sequence[str], rows: Rows) -> Rows:
    def rows_or_none(seen: Seen) -> jax.Array:
        finite = [jnp.all(jnp.isfinite(seen[name])) for name in names]
        return jnp.where(jnp.all(jnp.stack(finite)), rows(seen), -1)

    return rows_or_none


def _sector_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[] int32: the arm in whose sector the target lies."""
    direction = seen["xy_direction_to_target"]
    angle = jnp.arctan2(direction[1], direction[0]) - seen["disk_rotation"][2]
    sectors = jnp.floor(angle * num_arms / (2 * jnp.pi) + 0.5)
    return jnp.mod(sectors, num_arms).astype(jnp.int32)


def _steps_to_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: how many arms on, counter-clockwise, the target's sector lies from each."""
    return jnp.mod(_sector_of_target(seen, num_arms) - jnp.arange(num_arms), num_arms).astype(jnp.int32)


def _sides_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: 0 closest to the target, 1 left of the way there, 2 right of it, 3 opposite."""
    steps = _steps_to_target(seen, num_arms)
    side = jnp.where(2 * steps < num_arms, 2, jnp.where(2 * steps > num_arms, 1, 3))
    return jnp.where(steps == 0, 0, side).astype(jnp.int32)


def _cell(values: jax.Array, ranges: Sequence[Sequence[float]], cells: Sequence[int]) -> jax.Array:
    """[] int32: the cell of a grid in which values [k] lie; the last component's cells follow one another."""
    low, high = np.asarray(ranges, np.float32).T
    numbers = np.asarray(cells)
    place = jnp.floor((values - low) / (high - low) * numbers).astype(jnp.int32)
    strides = np.append(np.cumprod(numbers[:0:-1])[::-1], 1)
    return jnp.sum(jnp.clip(place, 0, numbers - 1) * strides).astype(jnp.int32)
