"""An environment as a table sees it: a row is observed, a column is chosen, and held for several steps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax

from core.algorithms.q_learning.action_sets import ActionSet, make_action_set, num_arms
from core.algorithms.q_learning.options import ActionSetOptions, ObservationGrid, StateDiscretizerOptions
from core.algorithms.q_learning.state_discretizers import StateDiscretizer, make_state_discretizer
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
        """Raises JobFailed("bad_model") where the environment lacks what they need."""
        table = cls(
            make_state_discretizer(state_discretizer, num_arms(environment)),
            make_action_set(action_set, environment),
        )
        _check_what_is_seen(state_discretizer, environment)
        return table

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
    """The finite decision process: `obs` is [num_readers] int32 rows, an action [num_readers] int32 columns.

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
        rows = self.table.state_discretizer(self.table.state_discretizer.look(state))
        return replace(state, obs=rows, info={**state.info, _OBSERVATION: state.obs})


def _without(info: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in info.items() if name not in names}


def _check_what_is_seen(state_discretizer: StateDiscretizerOptions, environment: Environment) -> None:
    state = jax.eval_shape(environment.reset, jax.random.PRNGKey(0))
    missing = [name for name in state_discretizer.needs if name not in ("observation", *state.info)]
    if missing:
        told = ", ".join(sorted(state.info)) or "nothing besides its observation"
        raise JobFailed(
            Reason.BAD_MODEL,
            f"The state discretizer looks at {', '.join(missing)}, and the environment tells {told}.",
        )
    seen = environment.observation_size
    size = seen["state"] if isinstance(seen, Mapping) else seen
    if isinstance(state_discretizer, ObservationGrid) and (beyond := state_discretizer.beyond(size)):
        detail = f"The observation has {size} components, and none of index {beyond[0]}."
        raise JobFailed(Reason.BAD_MODEL, detail)
