"""Many updates in one compiled loop, whatever one update does."""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol, TypeVar

import jax
import jax.numpy as jnp


class _Counted(Protocol):
    @property
    def num_updates(self) -> jax.Array: ...


class _Failure(Protocol):
    @property
    def quantities(self) -> jax.Array: ...


S = TypeVar("S", bound=_Counted)
H = TypeVar("H")
F = TypeVar("F", bound=_Failure)


def updates_until(
    update: Callable[[S, H], tuple[S, dict[str, jax.Array], F]],
    state: S,
    hyperparameters: H,
    until: jax.Array,
) -> tuple[S, dict[str, jax.Array], F]:
    """Update until `until` [] int32 updates are made, or one of them gives a value that is not finite.

    update: from a state and hyperparameters to the next state, its metrics, and which of its quantities were
    not finite. Returns the state after the last good update, metrics summed over the good ones, and what went
    wrong in the bad one. The result of a run does not depend on how it is cut into epochs.
    """
    # Traced once for both uses below, and inlined as if the second had traced it, too.
    once = jax.jit(update, inline=True)

    def going(carry: tuple[S, Any, F]) -> jax.Array:
        state, _, failure = carry
        return (state.num_updates < until) & ~jnp.any(failure.quantities)

    def advance(carry: tuple[S, Any, F]) -> tuple[S, Any, F]:
        state, sums, _ = carry
        new, metrics, failure = once(state, hyperparameters)
        good = ~jnp.any(failure.quantities)
        keep = partial(jax.tree.map, lambda a, b: jnp.where(good, a, b))
        return keep(new, state), keep(jax.tree.map(jnp.add, sums, metrics), sums), failure

    shapes = jax.eval_shape(once, state, hyperparameters)[1:]
    sums, failure = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return jax.lax.while_loop(going, advance, (state, sums, failure))
