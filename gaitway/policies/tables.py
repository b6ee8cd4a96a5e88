"""Q-learning's policies: a table, and a state discretizer that finds its rows."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitway.errors import PolicyUnreadable
from gaitway.policies import checkpoint

_FORMAT = "gaitway-q_learning-1"

Seen = Mapping[str, jax.Array]
Rows = Callable[[Seen], jax.Array]
Answer = Callable[[jax.Array, Seen, jax.Array], jax.Array]


def load(content: bytes, is_checkpoint: bool, deterministic: bool) -> tuple[jax.Array, Answer]:
    """The table [rows, columns], and (table, arrays by the names that the state discretizer needs, key) ->
    columns [num_parts] int32. Raises PolicyUnreadable."""
    facts, state = checkpoint.read(content, _FORMAT)
    table, epsilon = state["table"], facts["epsilon"]
    if is_checkpoint:
        agent = _policy_agent(state, facts)
        table, epsilon = table[agent], epsilon[agent]
    elif table.ndim != 2:
        raise PolicyUnreadable("This is a checkpoint, and no policy file.")
    # The file's name for the option `state_discretizer`.
    rows = rows_of(facts["indexer"], facts["num_arms"])
    explored = jnp.float32(epsilon)

    def answer(table: jax.Array, seen: Seen, key: jax.Array) -> jax.Array:
        best = jnp.argmax(table[rows(seen)], axis=-1).astype(jnp.int32)
        if deterministic:
            return best
        explore_key, choose_key = jax.random.split(key)
        explores = jax.random.uniform(explore_key, best.shape) < explored
        return jnp.where(explores, jax.random.randint(choose_key, best.shape, 0, table.shape[-1]), best)

    return jnp.asarray(table), answer


def _policy_agent(state: Mapping[str, Any], facts: Mapping[str, Any]) -> int:
    """The number of the agent whose table is the policy."""
    return int(np.argmax(state["eval_return"])) if facts["policy_agent"] == "best" else 0


def rows_of(options: Mapping[str, Any], num_arms: int) -> Rows:
    """From arrays by name to rows [num_parts] int32: -1 where what is seen is not finite.

    options: those of the job; `core.algorithms.q_learning.discrete_env` says what each kind is. Raises
    PolicyUnreadable for a kind that this version does not know.
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
    """[num_arms] int32: how many arms each lies clockwise of the one that faces the target."""
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
