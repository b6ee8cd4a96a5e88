"""The compiled functions of a run: traced and compiled once, before the first step."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, Protocol, TypeVar, cast

import jax
import jax.numpy as jnp

from core.algorithms.algorithm import Algorithm, Failure, S
from core.algorithms.evaluation import EpisodeTotals
from core.algorithms.events import Phase
from core.algorithms.lost_body import earlier
from core.compilation import compiling
from core.environments.wrappers.vectorized import ENVS


class _Counted(Protocol):
    @property
    def num_updates(self) -> jax.Array: ...


Counted = TypeVar("Counted", bound=_Counted)
Hyper = TypeVar("Hyper")


def updates_until(
    update: Callable[[Counted, Hyper], tuple[Counted, dict[str, jax.Array], Failure]],
    state: Counted,
    hyperparameters: Hyper,
    until: jax.Array,
) -> tuple[Counted, dict[str, jax.Array], Failure]:
    """Update until `until` [] int32 updates are made, or one of them gives a value that is not finite.

    update: from a state and hyperparameters to the next state, its metrics, and which of its quantities were
    not finite. Returns the state after the last good update, metrics summed over the good ones, and what went
    wrong in the bad one, with the first body that any of them lost. The result of a run does not depend on
    how it is cut into epochs.
    """
    # Traced once for both uses below, and inlined as if the second had traced it, too.
    once = jax.jit(update, inline=True)

    def going(carry: tuple[Counted, Any, Failure]) -> jax.Array:
        state, _, failure = carry
        return (state.num_updates < until) & ~jnp.any(failure.quantities)

    def advance(carry: tuple[Counted, Any, Failure]) -> tuple[Counted, Any, Failure]:
        state, sums, before = carry
        new, metrics, failure = once(state, hyperparameters)
        failure = failure._replace(lost=earlier(before.lost, failure.lost, state.num_updates))
        good = ~jnp.any(failure.quantities)
        keep = partial(jax.tree.map, lambda a, b: jnp.where(good, a, b))
        return keep(new, state), keep(jax.tree.map(jnp.add, sums, metrics), sums), failure

    shapes = jax.eval_shape(once, state, hyperparameters)[1:]
    sums, failure = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return jax.lax.while_loop(going, advance, (state, sums, failure))


@dataclass(frozen=True)
class CompiledFunctions(Generic[S]):
    """Functions that never compile again: other shapes are an error.

    init: the state before the first update, from a seed. epoch: see `updates_until`; it consumes the state
    that it is given. evaluate: see `Algorithm.evaluate`. whole: the state with every array whole in each
    process, for a checkpoint.
    """

    init: Callable[[Any], S]
    epoch: Callable[[S, Any, Any], tuple[S, Any, Failure]]
    evaluate: Callable[[Any, jax.Array, jax.Array], EpisodeTotals]
    whole: Callable[[S], S] = lambda state: state


def in_phases(
    trace_all: Callable[[], Callable[[], CompiledFunctions[S]]],
) -> tuple[CompiledFunctions[S], Sequence[Phase]]:
    """The functions, and how long tracing and compiling them took. trace_all: traces, as `trace` does."""
    started = time.perf_counter()
    compile_all = trace_all()
    traced = time.perf_counter()
    functions = compile_all()
    compiled = time.perf_counter()
    return functions, (Phase("trace", traced - started), Phase("compile", compiled - traced))


def trace(algorithm: Algorithm[S]) -> Callable[[], CompiledFunctions[S]]:
    """Trace every function, and compile each from then on; calling the result waits for all of them.

    Evaluations have few environments, so they run on the first device, with a copy of what they need.
    """
    epoch = _epoch(algorithm)
    count = jax.ShapeDtypeStruct((), jnp.int32)
    state = jax.eval_shape(algorithm.init, algorithm.seed)
    init_options, epoch_options = _where(algorithm, state)
    start = partial(compiling, options=compiler_options())
    # The one that takes longest begins.
    epoch = start(
        jax.jit(epoch, donate_argnums=0, **epoch_options).lower(state, algorithm.hyperparameters, count)
    )
    init = start(jax.jit(algorithm.init, **init_options).lower(algorithm.seed))
    evaluate = start(jax.jit(algorithm.evaluate).lower(algorithm.evaluated(state), state.eval_key, count))
    gather = start(_gathering(algorithm, state)) if algorithm.sharding.has_other_hosts else None

    def wait() -> CompiledFunctions[S]:
        on_the_first = algorithm.sharding.on_the_first(evaluate.result())
        functions = CompiledFunctions(init.result(), epoch.result(), on_the_first)
        if gather is None:
            return functions
        gathered = gather.result()
        return replace(functions, whole=lambda s: replace(s, **gathered(_split_parts(algorithm, s))))

    return wait


def trace_seeds(algorithm: Algorithm[S], seeds: Any) -> Callable[[], CompiledFunctions[S]]:
    """Like `trace`, for one run of each seed: every array but the hyperparameters has the seeds as its first
    axis, also `until` of an epoch.

    algorithm: for one device. seeds: the arguments of `init`, stacked.
    """
    epoch = jax.vmap(_epoch(algorithm), (0, None, 0))
    init, evaluate = jax.vmap(algorithm.init), jax.vmap(algorithm.evaluate)
    state = jax.eval_shape(init, seeds)
    start = partial(compiling, options=compiler_options())
    updates = start(
        jax.jit(epoch, donate_argnums=0).lower(state, algorithm.hyperparameters, state.num_updates)
    )
    begin = start(jax.jit(init).lower(seeds))
    evaluation = start(jax.jit(evaluate).lower(algorithm.evaluated(state), state.eval_key, state.num_updates))
    return lambda: CompiledFunctions(begin.result(), updates.result(), evaluation.result())


def _epoch(algorithm: Algorithm[S]) -> Callable[[S, Any, jax.Array], tuple[S, dict[str, jax.Array], Failure]]:
    def epoch(state: S, hyperparameters: Any, until: jax.Array) -> tuple[S, dict[str, jax.Array], Failure]:
        return updates_until(algorithm.update, state, hyperparameters, until)

    return epoch


def compiler_options() -> Any:
    """XLA's options. LLVM's level 1 compiles the ant in two thirds of the time, to the same bits and speed.

    Where JAX is told to optimise little, it asks for less itself.
    """
    if jax.default_backend() != "cpu" or jax.config.read("jax_disable_most_optimizations"):
        return None
    return {"xla_backend_optimization_level": 1}


def place(algorithm: Algorithm[S], state: S) -> S:
    """Put a state's arrays on the devices that share the run."""
    if algorithm.sharding.mesh is None:
        return jax.tree.map(jnp.asarray, state)
    return algorithm.sharding.put(state, _shardings(algorithm, state))


def _gathering(algorithm: Algorithm[S], state: S) -> Any:
    """The lowered program that brings what is split to every device."""
    parts = _split_parts(algorithm, state)
    everywhere, split = algorithm.sharding.of_axes(), algorithm.sharding.of_axes(ENVS)
    return jax.jit(lambda x: x, in_shardings=(split,), out_shardings=everywhere).lower(parts)


def _split_parts(algorithm: Algorithm[S], state: S) -> dict[str, Any]:
    return {name: getattr(state, name) for name in algorithm.split_fields}


def _where(algorithm: Algorithm[S], state: S) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options of `jax.jit` for `init` and for an epoch: where their inputs and outputs lie."""
    if algorithm.sharding.mesh is None:
        return {}, {}
    shardings, everywhere = _shardings(algorithm, state), algorithm.sharding.of_axes()
    both = (shardings, everywhere, everywhere)
    init = {"in_shardings": (everywhere,), "out_shardings": shardings}
    return init, {"in_shardings": both, "out_shardings": both}


def _shardings(algorithm: Algorithm[S], state: S) -> Any:
    """Where each array of a state lies: environments are split, everything else is on every device."""
    sharding = algorithm.sharding
    everywhere: Any = jax.tree.map(lambda _: sharding.of_axes(), cast("Any", state))
    split = {
        name: jax.tree.map(lambda _: sharding.of_axes(ENVS), getattr(state, name))
        for name in algorithm.split_fields
    }
    return replace(everywhere, **split)
