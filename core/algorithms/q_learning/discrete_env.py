"""An environment as a table sees it: a row is observed, a column is chosen, and held for several steps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from core.algorithms.q_learning.spec import (
    ActionList,
    ActionSetOptions,
    ArmActions,
    ArmAmplitudes,
    ArmRole,
    ArmRoles,
    ArmSide,
    ArmTowardsTarget,
    DiskPositionGrid,
    LeadingArm,
    ObservationGrid,
    StateDiscretizerOptions,
)
from core.environments.environment import ActionSet, Environment, Seen, State, StateDiscretizer, Wrapped
from core.environments.wrappers.action_repeat import repeat_action
from core.errors import JobFailed
from core.physics.engine import NOMINAL, ModelFields
from core.reasons import Reason


def make_action_set(options: ActionSetOptions, environment: Environment) -> ActionSet:
    """The action set that these options name.

    Raises JobFailed("bad_model") where the environment does not offer it, or takes other actions.
    """
    match options:
        case LeadingArm() | ArmRoles() | ArmAmplitudes():
            offered = environment.discretization.action_sets.get(options.kind)
            if offered is None:
                raise JobFailed(Reason.BAD_MODEL, f"The environment offers no action set {options.kind!r}.")
            return offered
        case ActionList(actions=actions) | ArmActions(actions=actions):
            table, size = np.asarray(actions, np.float32), environment.action_size
            length = table.shape[1]
            parts = size // length if isinstance(options, ArmActions) else 1
            if parts * length != size:
                detail = f"The action set's actions have {length} components, the environment's {size}."
                raise JobFailed(Reason.BAD_MODEL, detail)
            return ActionSet(len(table), parts, lambda choices: jnp.asarray(table)[choices].reshape(-1))


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


# The environment below keeps these in `State.info`, too.
_OBSERVATION = "inner_observation"


@dataclass(frozen=True)
class Tabular:
    """How a table's rows and columns mean something in an environment."""

    state_discretizer: StateDiscretizer
    action_set: ActionSet

    @classmethod
    def of(
        cls,
        state_discretizer: StateDiscretizerOptions,
        action_set: ActionSetOptions,
        environment: Environment,
    ) -> "Tabular":
        """Raises JobFailed("bad_model") where the environment lacks what they need, or they differ in
        parts."""
        table = cls(
            make_state_discretizer(state_discretizer, environment),
            make_action_set(action_set, environment),
        )
        readers, choosers = table.state_discretizer.num_parts, table.action_set.num_parts
        if readers != choosers:
            raise JobFailed(
                Reason.BAD_MODEL,
                f"The state discretizer reads {readers} rows in each state, and the action set takes "
                f"{choosers} choices.",
            )
        return table

    def rows(self, state: State) -> jax.Array:
        """The rows [num_parts] int32 of one environment's state."""
        return self.state_discretizer(seen_in(state, self.state_discretizer.needs))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.state_discretizer.num_states, self.action_set.num_choices

    def check_shape(self, shape: tuple[int, ...]) -> None:
        """Raises JobFailed("bad_checkpoint") where a table of this shape is one of another environment."""
        if shape != self.shape:
            raise JobFailed(
                Reason.BAD_CHECKPOINT,
                f"The table is {list(shape)}, and this environment needs {list(self.shape)}.",
            )


@dataclass(frozen=True)
class DiscreteEnv(Wrapped):
    """The finite decision process: `obs` is [num_parts] int32 rows, an action [num_parts] int32 columns.

    A step is `decision_steps` of the environment's, whose rewards add up; one that ends the episode is the
    last one taken.
    """

    table: Tabular
    decision_steps: int

    @property
    def dt(self) -> float:
        return self._held.dt

    @property
    def episode_length(self) -> int:
        return self._held.episode_length

    def reset(self, key: jax.Array, model: ModelFields = NOMINAL) -> State:
        return self._read(self._held.reset(key, model))

    def step(self, state: State, action: jax.Array) -> State:
        inner = replace(state, obs=state.info[_OBSERVATION], info=_without(state.info, _OBSERVATION))
        return self._read(self._held.step(inner, self.table.action_set.act(action)))

    @property
    def _held(self) -> Environment:
        return repeat_action(self.environment, self.decision_steps)

    def _read(self, state: State) -> State:
        return replace(state, obs=self.table.rows(state), info={**state.info, _OBSERVATION: state.obs})


def _without(info: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in info.items() if name not in names}
