"""From a job's options to a state discretizer: one that the environment offers, or a grid."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.q_learning.options import (
    ArmRole,
    ArmSide,
    ArmTowardsTarget,
    DiskPositionGrid,
    ObservationGrid,
    StateDiscretizerOptions,
)
from core.environments.discretization import Seen, StateDiscretizer
from core.environments.environment import Environment, State
from core.errors import JobFailed
from core.reasons import Reason


def make_state_discretizer(options: StateDiscretizerOptions, environment: Environment) -> StateDiscretizer:
    """The state discretizer that these options name.

    Raises JobFailed("bad_model") where the environment does not offer it, or lacks what it needs.
    """
    match options:
        case ArmTowardsTarget() | ArmRole() | ArmSide():
            offered = environment.discretization.state_discretizers.get(options.kind)
            if offered is None:
                raise JobFailed(
                    Reason.BAD_MODEL, f"The environment offers no state discretizer {options.kind!r}."
                )
            return offered
        case DiskPositionGrid() | ObservationGrid():
            _check_needs(options, environment)
            return make_grid(options)


def make_grid(options: DiskPositionGrid | ObservationGrid) -> StateDiscretizer:
    """A grid over components of what is seen: it needs no environment."""
    match options:
        case DiskPositionGrid(x=x, y=y, cells=cells):
            ranges, chosen = np.asarray([x, y], np.float32), np.array([0, 1])
        case ObservationGrid(components=components):
            ranges = np.asarray([component.range for component in components], np.float32)
            chosen = np.asarray([component.index for component in components])
            cells = [component.cells for component in components]
    name = options.looks_at
    return StateDiscretizer(
        (name,), options.num_states, 1, lambda seen: cell(seen[name][chosen], ranges, cells)[None]
    )


def seen_in(state: State, needs: tuple[str, ...]) -> Seen:
    """The parts of one environment's state that a state discretizer needs, by name."""
    obs = state.obs["state"] if isinstance(state.obs, Mapping) else state.obs
    return {name: obs if name == "observation" else state.info[name] for name in needs}


def cell(values: jax.Array, ranges: np.ndarray, cells: list[int]) -> jax.Array:
    """[] int32: the cell of a grid in which values [k] lie; the last component's cells follow one another.

    ranges: [k, 2], low and high; cells: how many each is cut into.
    """
    low, high = ranges.T
    numbers = np.asarray(cells)
    place = jnp.floor((values - low) / (high - low) * numbers).astype(jnp.int32)
    strides = np.append(np.cumprod(numbers[:0:-1])[::-1], 1)
    return jnp.sum(jnp.clip(place, 0, numbers - 1) * strides).astype(jnp.int32)


def _check_needs(options: DiskPositionGrid | ObservationGrid, environment: Environment) -> None:
    state = jax.eval_shape(environment.reset, jax.random.PRNGKey(0))
    if options.looks_at not in ("observation", *state.info):
        told = ", ".join(sorted(state.info)) or "nothing besides its observation"
        raise JobFailed(
            Reason.BAD_MODEL,
            f"The state discretizer looks at {options.looks_at}, and the environment tells {told}.",
        )
    seen = environment.observation_size
    size = seen["state"] if isinstance(seen, Mapping) else seen
    if isinstance(options, ObservationGrid) and (beyond := options.beyond(size)):
        detail = f"The observation has {size} components, and none of index {next(iter(beyond.values()))}."
        raise JobFailed(Reason.BAD_MODEL, detail)
