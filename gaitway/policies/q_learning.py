"""Q-learning's policies: a table, and a state discretizer that finds its rows."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gaitway.errors import PolicyUnreadable
from gaitway.policies import checkpoint
from gaitway.policies.state_discretizers import Seen, rows_of

_FORMAT = "gaitway-q_learning-1"

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
