"""An environment as a table sees it: a row is observed, a column is chosen, and held for several steps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax

from core.algorithms.q_learning.action_sets import make_action_set
from core.algorithms.q_learning.options import ActionSetOptions, StateDiscretizerOptions
from core.algorithms.q_learning.state_discretizers import make_state_discretizer, seen_in
from core.environments.discretization import ActionSet, StateDiscretizer
from core.environments.environment import Environment, State
from core.environments.wrappers.action_repeat import repeat_action
from core.environments.wrappers.base import Wrapped
from core.errors import JobFailed
from core.physics.engine import NOMINAL, ModelFields
from core.reasons import Reason

# What the environment below keeps in `State.info`, besides what is there.
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
