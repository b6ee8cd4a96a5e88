"""A learnt table on its own: out of a checkpoint, as a file, and acting."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from core.algorithms.checkpoint import Format
from core.algorithms.q_learning.discrete_env import Tabular
from core.algorithms.q_learning.options import (
    ActionSetOptions,
    StateDiscretizerOptions,
)
from core.algorithms.q_learning.table import epsilon_greedy, greedy
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments.environment import Environment, State
from core.environments.wrappers.action_hold import ActionHold
from core.errors import JobFailed
from core.reasons import Reason

_STORED_NAMES = {"state_discretizer": "indexer", "action_set": "mapper", "num_states": "num_arms"}
_NAMES = {stored: name for name, stored in _STORED_NAMES.items()}


class _Format(Format):
    """The file's own names: `indexer`, `mapper`, and `num_arms` for the number of states, which only
    discretizers with as many states as arms read."""

    def pack(self, description: Mapping[str, Any], progress: Mapping[str, int], state: Any) -> bytes:
        header = {_STORED_NAMES.get(name, name): value for name, value in description.items()}
        return super().pack(header, progress, state)

    def read(self, content: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
        header, state = super().read(content)
        return {_NAMES.get(name, name): value for name, value in header.items()}, state


FORMAT = _Format("gaitway-q_learning-1")

_STATE_DISCRETIZER: TypeAdapter[StateDiscretizerOptions] = TypeAdapter(StateDiscretizerOptions)
_ACTION_SET: TypeAdapter[ActionSetOptions] = TypeAdapter(ActionSetOptions)


class LearntTable(NamedTuple):
    """A table [S, A], how often each of its cells was learnt from, and the options that it belongs to.

    facts: `state_discretizer`, `action_set`, `decision_steps`, `num_states`, `epsilon` (the share of random
    choices where noise is asked for), and others; a checkpoint has a list of `epsilon`, one for each agent.
    """

    table: NDArray[np.float32]
    visits: NDArray[np.int32]
    facts: Mapping[str, Any]


def write_policy(learnt: LearntTable) -> bytes:
    """The file of a policy: equal tables give equal bytes."""
    return FORMAT.pack(learnt.facts, {}, {"table": learnt.table, "visits": learnt.visits})


def read_policy(content: bytes) -> LearntTable:
    """Back from a policy file. Raises JobFailed("bad_checkpoint") for anything else."""
    header, state = FORMAT.read(content)
    if state["table"].ndim != 2:
        raise JobFailed(Reason.BAD_CHECKPOINT, "This is a checkpoint, and no policy file.")
    return LearntTable(state["table"], state["visits"], header)


def table_from_checkpoint(content: bytes) -> LearntTable:
    """The table that is the policy of a checkpoint. Raises JobFailed if it is damaged."""
    header, state = FORMAT.read(content)
    agent = policy_agent(state["eval_return"], header["policy_agent"])
    return of_agent(agent, state["table"], state["visits"], header)


def of_agent(
    agent: int, table: NDArray[np.float32], visits: NDArray[np.int32], facts: Mapping[str, Any]
) -> LearntTable:
    """One agent's, of all agents' tables and visits [agents, S, A] and a checkpoint's facts."""
    return LearntTable(table[agent], visits[agent], {**facts, "epsilon": facts["epsilon"][agent]})


def policy_agent(eval_return: NDArray[np.float32], which: str) -> int:
    """The number of the agent whose table is the policy."""
    return int(np.argmax(eval_return)) if which == "best" else 0


def load(content: bytes, *, is_checkpoint: bool, deterministic: bool = True) -> TrainedPolicy:
    """The table of a checkpoint or a policy file, ready to act. Raises JobFailed if it is damaged."""
    learnt = table_from_checkpoint(content) if is_checkpoint else read_policy(content)
    facts = learnt.facts
    state_discretizer = _STATE_DISCRETIZER.validate_python(facts["state_discretizer"])
    action_set = _ACTION_SET.validate_python(facts["action_set"])
    epsilon = jnp.float32(0.0 if deterministic else facts["epsilon"])

    def choose(table: jax.Array, rows: jax.Array, key: jax.Array) -> jax.Array:
        return greedy(table, rows) if deterministic else epsilon_greedy(table, rows, epsilon, key)

    def acting(environment: Environment) -> Acting:
        tabular = Tabular.of(state_discretizer, action_set, environment)
        tabular.check_shape(learnt.table.shape)
        steps = facts["decision_steps"]

        def act(table: jax.Array, state: State, key: jax.Array) -> jax.Array:
            choices = choose(table, tabular.rows(state), key)
            return ActionHold.due_or_held(state, steps, tabular.action_set.act(choices))

        return Acting(ActionHold(environment), act)

    return TrainedPolicy(jnp.asarray(learnt.table), acting)
