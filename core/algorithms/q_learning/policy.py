"""A learnt table on its own: out of a checkpoint, as a file, and acting."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from core.algorithms.checkpoint import Format
from core.algorithms.policy import Acting, TrainedPolicy
from core.algorithms.q_learning.discrete_env import Tabular
from core.algorithms.q_learning.options import IndexerOptions, MapperOptions
from core.algorithms.q_learning.state_discretizers import make_indexer
from core.algorithms.q_learning.table import epsilon_greedy, greedy
from core.environments.environment import Environment, State
from core.environments.wrappers.action_hold import ActionHold
from core.errors import JobFailed

FORMAT = Format("gaitway-q_learning-1")

_INDEXER: TypeAdapter[IndexerOptions] = TypeAdapter(IndexerOptions)
_MAPPER: TypeAdapter[MapperOptions] = TypeAdapter(MapperOptions)


class LearntTable(NamedTuple):
    """A table [S, A], how often each of its cells was learnt from, and the options that it belongs to.

    facts: `indexer`, `mapper`, `decision_steps`, `num_arms`, `epsilon` (the share of choices at random where
    noise is asked for), and others; in those of a checkpoint `epsilon` is a list, one of each agent.
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
        raise JobFailed("bad_checkpoint", "This is a checkpoint, and no policy file.")
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
    """What a checkpoint or a policy file holds, ready to act; its answer are columns [num_readers] for what
    the indexer needs, by name. Raises JobFailed if it is damaged."""
    learnt = table_from_checkpoint(content) if is_checkpoint else read_policy(content)
    facts = learnt.facts
    indexer, mapper = _INDEXER.validate_python(facts["indexer"]), _MAPPER.validate_python(facts["mapper"])
    epsilon = jnp.float32(0.0 if deterministic else facts["epsilon"])

    def choose(table: jax.Array, rows: jax.Array, key: jax.Array) -> jax.Array:
        return greedy(table, rows) if deterministic else epsilon_greedy(table, rows, epsilon, key)

    def answer(table: jax.Array, seen: Mapping[str, jax.Array], key: jax.Array) -> jax.Array:
        return choose(table, make_indexer(indexer, facts["num_arms"])(seen), key)

    def acting(environment: Environment) -> Acting:
        tabular = Tabular.of(indexer, mapper, environment)
        tabular.check_shape(learnt.table.shape)
        steps = facts["decision_steps"]

        def act(table: jax.Array, state: State, key: jax.Array) -> jax.Array:
            choices = choose(table, tabular.indexer(tabular.indexer.look(state)), key)
            return ActionHold.due_or_held(state, steps, tabular.mapper.act(choices))

        return Acting(ActionHold(environment), act)

    return TrainedPolicy(jnp.asarray(learnt.table), acting, answer)
