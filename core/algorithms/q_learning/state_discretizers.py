"""State state_discretizers: from what is seen of a world to a row of the table, or to one for each arm."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.q_learning.options import (
    ArmRole,
    ArmTowardsTarget,
    DiskPositionGrid,
    ObservationGrid,
    StateDiscretizerOptions,
)
from core.environments.environment import State

# Arrays by the names that a state discretizer's options need.
Seen = Mapping[str, jax.Array]


@dataclass(frozen=True)
class StateDiscretizer:
    """rows: from what is seen of one world to [num_readers] int32, each below num_states.

    A row is -1 where what is seen is not finite. num_readers: 1, or the arms where each reads for itself.
    names: the rows', for people; empty where their numbers say as much.
    """

    needs: tuple[str, ...]
    num_states: int
    num_readers: int
    rows: Callable[[Seen], jax.Array]
    names: tuple[str, ...] = ()

    def look(self, state: State) -> Seen:
        """What the state discretizer needs of one world's state."""
        obs = state.obs["state"] if isinstance(state.obs, Mapping) else state.obs
        return {name: obs if name == "observation" else state.info[name] for name in self.needs}

    def __call__(self, seen: Seen) -> jax.Array:
        finite = [jnp.all(jnp.isfinite(seen[name])) for name in self.needs]
        return jnp.where(jnp.all(jnp.stack(finite)), self.rows(seen), -1)


def make_state_discretizer(options: StateDiscretizerOptions, num_arms: int) -> StateDiscretizer:
    """The state discretizer that these options name, for a body with `num_arms` arms."""
    names = ()
    match options:
        case ArmTowardsTarget():
            names = tuple(f"target: arm {arm}" for arm in range(num_arms))
            readers, rows = 1, lambda seen: sector_of_target(seen, num_arms)[None]
        case ArmRole():
            names = ("target: this arm", *(f"target: {steps} to the left" for steps in range(1, num_arms)))
            readers, rows = num_arms, lambda seen: steps_to_target(seen, num_arms)
        case DiskPositionGrid(x=x, y=y, cells=cells):
            ranges = np.asarray([x, y], np.float32)
            readers, rows = 1, lambda seen: cell(seen["disk_position"][:2], ranges, cells)[None]
        case ObservationGrid(components=components):
            ranges = np.asarray([component.range for component in components], np.float32)
            chosen = np.asarray([component.index for component in components])
            cells = [component.cells for component in components]
            readers, rows = 1, lambda seen: cell(seen["observation"][chosen], ranges, cells)[None]
    return StateDiscretizer(options.needs, options.num_states(num_arms), readers, rows, names)


def sector_of_target(seen: Seen, num_arms: int) -> jax.Array:
    """[] int32: the arm in whose sector the target lies.

    Arm k points at 2π k / num_arms from the disk's x axis, and its sector reaches π / num_arms to both sides;
    the clockwise edge belongs to it. Source: the tutorial notebook's direction bins, with the angle wrapped.
    """
    direction = seen["xy_direction_to_target"]
    angle = jnp.arctan2(direction[1], direction[0]) - seen["disk_rotation"][2]
    sectors = jnp.floor(angle * num_arms / (2 * jnp.pi) + 0.5)
    return jnp.mod(sectors, num_arms).astype(jnp.int32)


def steps_to_target(seen: Seen, num_arms: int) -> jax.Array:
    """[num_arms] int32: how many arms on, counter-clockwise, the target's sector lies from each."""
    return jnp.mod(sector_of_target(seen, num_arms) - jnp.arange(num_arms), num_arms).astype(jnp.int32)


def cell(values: jax.Array, ranges: np.ndarray, cells: list[int]) -> jax.Array:
    """[] int32: the cell of a grid in which values [k] lie; the last component's cells follow one another.

    ranges: [k, 2], low and high; cells: how many each is cut into.
    """
    low, high = ranges.T
    numbers = np.asarray(cells)
    place = jnp.floor((values - low) / (high - low) * numbers).astype(jnp.int32)
    strides = np.append(np.cumprod(numbers[:0:-1])[::-1], 1)
    return jnp.sum(jnp.clip(place, 0, numbers - 1) * strides).astype(jnp.int32)
