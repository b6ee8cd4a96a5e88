"""The Q-table: how a choice is made of it, how it learns, and its file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import NDArray
from pydantic import TypeAdapter

from core.algorithms import experience
from core.algorithms.checkpoint import Format
from core.algorithms.experience import Scalar, decayed
from core.algorithms.q_learning.discrete_env import Tabular
from core.algorithms.q_learning.spec import (
    ActionSetOptions,
    QLearningSpec,
    StateDiscretizerOptions,
)
from core.algorithms.spec import EpsilonShape
from core.algorithms.trained_policy import Acting, TrainedPolicy
from core.environments.environment import Environment, State
from core.environments.wrappers.action_repeat import ActionHold
from core.errors import JobFailed
from core.reasons import Reason

Table = Float[Array, "S A"]


class Transitions(NamedTuple):
    """N steps of the decision process, [N] each.

    row, choice, next_row: int32. reward: summed over the decision. ended: 1 where the environment ended the
    episode, so that nothing follows; 0 also where its length cut it off. weight: 1, or 0 where nothing is to
    be learnt.
    """

    row: Int[Array, " N"]
    choice: Int[Array, " N"]
    reward: Float[Array, " N"]
    next_row: Int[Array, " N"]
    ended: Float[Array, " N"]
    weight: Float[Array, " N"]


def greedy(table: Table, rows: Int[Array, "*rows"]) -> Int[Array, "*rows"]:
    """The best columns [...] int32 of these rows [...], of equal ones the first."""
    return experience.greedy(table[rows])


def epsilon_greedy(
    table: Table, rows: Int[Array, "*rows"], epsilon: Scalar, key: jax.Array
) -> Int[Array, "*rows"]:
    """The best columns [...] int32, but with probability epsilon [] any."""
    return experience.epsilon_greedy(table[rows], epsilon, key)


def td_errors(table: Table, steps: Transitions, discounting: Scalar) -> Float[Array, " N"]:
    """[N]: r + γ max_a Q(s', a) - Q(s, a), without the middle term where the episode ended.

    Source: Watkins & Dayan, Q-learning (1992); Sutton & Barto (2018), eq. 6.8.
    """
    follows = discounting * (1 - steps.ended) * jnp.max(table[steps.next_row], axis=-1)
    return steps.reward + follows - table[steps.row, steps.choice]


def learn(
    table: Table,
    steps: Transitions,
    errors: Float[Array, " N"],
    learning_rate: Scalar,
    *,
    compound: bool = False,
) -> tuple[Table, Table]:
    """The table [S, A] after these transitions, and how many each of its cells had, [S, A] float32.

    All errors [N] are taken before any of it is learnt. A cell that n of the transitions visit takes one
    step towards the mean of their targets: α of the way, or with `compound` 1 - (1 - α)^n, as far as n steps
    of α towards that mean lead. For n = 1 both are Q-learning's own step.
    """
    cells = (steps.row, steps.choice)
    visits = jnp.zeros_like(table).at[cells].add(steps.weight)
    sums = jnp.zeros_like(table).at[cells].add(steps.weight * errors)
    rate = 1 - (1 - learning_rate) ** visits if compound else learning_rate
    return table + rate * sums / jnp.maximum(visits, 1), visits


@dataclass(frozen=True)
class Exploration:
    """The part of the schedule that is compiled in.

    decisions: of an agent in one round, in all of its environments.
    """

    by_episodes: bool
    shape: EpsilonShape
    decisions_per_round: int
    num_envs: int

    @classmethod
    def of(cls, settings: QLearningSpec) -> "Exploration":
        return cls(
            by_episodes=settings.epsilon.decay_episodes is not None,
            shape=settings.epsilon.shape,
            decisions_per_round=settings.num_envs * settings.decisions_per_episode,
            num_envs=settings.num_envs,
        )

    def epsilon(
        self, start: jax.Array, end: jax.Array, length: jax.Array, rounds: jax.Array, decision: jax.Array
    ) -> jax.Array:
        """Epsilon in the decision [] int32 of an episode, after `rounds` whole rounds [] int32.

        From `start` to `end`, in `length` episodes or decisions, and then it stays.
        """
        per_round = self.num_envs if self.by_episodes else self.decisions_per_round
        within = 0 if self.by_episodes else decision * self.num_envs
        # In float32 from the beginning: a long run has more decisions than an int32 counts.
        done = rounds.astype(jnp.float32) * per_round + within
        return decayed(start, end, done / length, self.shape)


def decay_length(settings: QLearningSpec) -> int:
    """In the schedule's own unit: episodes, or an agent's decisions."""
    epsilon = settings.epsilon
    return epsilon.decay_episodes or epsilon.decay_decisions or settings.num_decisions


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
