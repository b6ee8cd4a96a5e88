"""Finite views of an environment, for algorithms that keep a table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

# Arrays by the names that a state discretizer needs: entries of `State.info`, and `observation`.
Seen = Mapping[str, jax.Array]


@dataclass(frozen=True)
class StateDiscretizer:
    """find_rows: from what is seen of one environment to [num_parts] int32 row numbers, each below
    num_states.

    num_parts: parts of the body that read for themselves, such as arms; 1: the whole body does.
    names: the rows', for people; empty where their numbers say as much.
    """

    needs: tuple[str, ...]
    num_states: int
    num_parts: int
    find_rows: Callable[[Seen], jax.Array]
    names: tuple[str, ...] = ()

    def __call__(self, seen: Seen) -> jax.Array:
        """The rows [num_parts] int32; -1 where what is needed is not finite."""
        finite = [jnp.all(jnp.isfinite(seen[name])) for name in self.needs]
        return jnp.where(jnp.all(jnp.stack(finite)), self.find_rows(seen), -1)


@dataclass(frozen=True)
class ActionSet:
    """act: from choices [num_parts] int32, each below num_choices, to an action [action_size].

    num_parts: parts of the body that choose for themselves, such as arms; 1: the whole body does.
    names: the choices', for people; empty where their numbers say as much.
    """

    num_choices: int
    num_parts: int
    act: Callable[[jax.Array], jax.Array]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Discretization:
    """The finite views that an environment itself offers, by the names that jobs use."""

    state_discretizers: Mapping[str, StateDiscretizer] = field(default_factory=dict[str, StateDiscretizer])
    action_sets: Mapping[str, ActionSet] = field(default_factory=dict[str, ActionSet])


CONTINUOUS = Discretization()
