"""The table's own arithmetic: how a choice is made of it, and how it learns from many transitions at once."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from core.algorithms import exploration
from core.algorithms.exploration import Scalar

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
    return exploration.greedy(table[rows])


def epsilon_greedy(
    table: Table, rows: Int[Array, "*rows"], epsilon: Scalar, key: jax.Array
) -> Int[Array, "*rows"]:
    """The best columns [...] int32, but with probability epsilon [] any."""
    return exploration.epsilon_greedy(table[rows], epsilon, key)


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
