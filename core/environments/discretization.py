"""Finite views of an environment, for algorithms that keep a table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

# Arrays by the names that a state discretizer needs: entries of `State.info`, and `observation`.
Seen = Mapping[str, jax.Array]


@dataclass(frozen=True)
class StateDiscretizer:
    """rows: from `Seen` of one environment to [num_readers] int32, each below num_states.

    num_readers: 1, or the parts of the body where each reads for itself. names: the rows', for people; empty
    where their numbers say as much.
    """

    needs: tuple[str, ...]
    num_states: int
    num_readers: int
    rows: Callable[[Seen], jax.Array]
    names: tuple[str, ...] = ()

    def __call__(self, seen: Seen) -> jax.Array:
        """The rows [num_readers] int32; -1 where what is needed is not finite."""
        finite = [jnp.all(jnp.isfinite(seen[name])) for name in self.needs]
        return jnp.where(jnp.all(jnp.stack(finite)), self.rows(seen), -1)


@dataclass(frozen=True)
class ActionSet:
    """act: from choices [num_choosers] int32, each below num_choices, to an action [action_size].

    names: the choices', for people; empty where their numbers say as much.
    """

    num_choices: int
    num_choosers: int
    act: Callable[[jax.Array], jax.Array]
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Discretization:
    """The finite views that an environment itself offers, by the names that jobs use."""

    state_discretizers: Mapping[str, StateDiscretizer] = field(default_factory=dict[str, StateDiscretizer])
    action_sets: Mapping[str, ActionSet] = field(default_factory=dict[str, ActionSet])


CONTINUOUS = Discretization()
